# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The lines of Python in the README, as a newcomer runs them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from PIL import Image

from dotsim_ros.optics.picture import TITLE_HEIGHT_PX

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", ["README.md", "docs/index.md"])
def test_the_lines_of_python_press_and_save(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = (ROOT / name).read_text(encoding="utf-8")
    code = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert len(code) == 1
    assert len([line for line in code[0].splitlines() if line]) <= 5
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(code[0], names)
    frame = names["frame"]
    assert frame.wrench.force_n[2] > 0.0  # type: ignore[attr-defined]
    height, width = frame.image.shape[:2]  # type: ignore[attr-defined]
    assert Image.open("press.png").size == (3 * width, height + TITLE_HEIGHT_PX)
