"""Where the files that travel with the package lie: sensors, images, RViz and Foxglove layouts."""

from importlib.resources import files
from pathlib import Path

PACKAGE_ROOT = Path(str(files("dotsim_ros")))


def parameter_path(relative: str) -> Path:
    """Return the path of a file below `params/`, in an installed package or in a source checkout.

    Raises:
        FileNotFoundError: no such file; the message names the folders that were searched.
    """
    candidates = [PACKAGE_ROOT / "params" / relative, PACKAGE_ROOT.parent / "params" / relative]
    for candidate in candidates:
        if candidate.exists():
            return candidate
    searched = ", ".join(str(candidate) for candidate in candidates)
    raise FileNotFoundError(f"no parameter file {relative!r}; searched {searched}")
