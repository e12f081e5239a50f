"""Weights of a network of images, and the card that says what they are: a folder of three files.

- `weights.safetensors`: the weights; its header carries the card.
- `network.onnx`: the network's graph, whose weights are those of the file beside it.
- `card.json`: the card once more, to be read by people.

A card names the sensor and the camera, so that weights are never used on another.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from dotsim_ros.geometry.camera import FisheyeCamera
from dotsim_ros.view.files import whole_file

FORMAT = 1
"""Raised whenever a network's input or output changes its meaning."""

WEIGHTS = "weights.safetensors"
GRAPH = "network.onnx"
CARD = "card.json"
CARD_KEY = "card"

BASES = {"ours": "carried", "paper": "idle", "paper_direct": "none", "unet": "idle"}
"""What each kind of network's output is added to."""
FINENESS = {"ours": 2, "paper": 1, "paper_direct": 1, "unet": 1}
"""How often wider and higher each kind's images are than the geometry that it is given."""


@dataclass(frozen=True)
class NetworkCard:
    """What weights are, where they come from, and what they are worth.

    Attributes:
        version: of the format.
        kind: of the network.
        sensor: name of the sensor.
        camera: `camera_hash` of its camera.
        width, height: of the network's images.
        weights_sha256: of the weights, by `weights_hash`.
        graph_sha256: of the graph's file.
        data: what it was trained on.
        commit, date, command: that it was trained by.
        metrics: figures by name.
    """

    version: int
    kind: str
    sensor: str
    camera: str
    width: int
    height: int
    weights_sha256: str
    graph_sha256: str
    data: dict[str, Any] = field(default_factory=dict)
    commit: str = ""
    date: str = ""
    command: str = ""
    metrics: dict[str, float] = field(default_factory=dict)

    def text(self) -> str:
        """Return the card as JSON."""
        return json.dumps(asdict(self), indent=2)


def camera_hash(camera: FisheyeCamera) -> str:
    """Return what tells cameras apart whose images differ by more than their number of pixels."""
    numbers = [
        camera.width / camera.height,
        camera.focal_px / camera.height,
        *((camera.principal_point_px + 0.5) / camera.height),
        *camera.distortion,
        *camera.pose.position_m,
        *camera.pose.rotation().ravel(),
    ]
    text = " ".join(f"{number:.6f}" for number in np.asarray(numbers) + 0.0)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def weights_hash(weights: Mapping[str, NDArray[Any]]) -> str:
    """Return the SHA-256 of weights: names, shapes and values."""
    digest = hashlib.sha256()
    for name in sorted(weights):
        array = np.ascontiguousarray(weights[name])
        digest.update(f"{name} {array.dtype} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def _card_of(text: str, path: Path) -> NetworkCard:
    known = {entry.name for entry in fields(NetworkCard)}
    try:
        record = json.loads(text)
        version = record["version"]
        if version == FORMAT and set(record) == known:
            return NetworkCard(**record)
    except (json.JSONDecodeError, TypeError, KeyError) as error:
        raise ValueError(f"{path} has no card that can be read ({error})") from error
    if version != FORMAT:
        raise ValueError(
            f"{path} is of version {version}, expected {FORMAT}; train the network anew with this "
            "version of the package"
        )
    raise ValueError(
        f"{path}: its card has the entries {sorted(record)}, expected {sorted(known)}; train the "
        "network anew"
    )


def _file_hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def read_network(directory: Path) -> NetworkCard:
    """Return the card of a network after a check that its files are whole.

    Raises:
        FileNotFoundError: no such folder, or one without weights or graph.
        ValueError: a file is corrupt, does not belong to the other, or is of another version.
    """
    path, graph = directory / WEIGHTS, directory / GRAPH
    for needed in (path, graph):
        if not needed.is_file():
            raise FileNotFoundError(
                f"{directory} holds no network: there is no {needed.name}; make one with "
                "dotsim_ros train-optics"
            )
    try:
        with safe_open(path, framework="numpy") as content:
            card = _card_of((content.metadata() or {}).get(CARD_KEY, "null"), path)
            weights = {name: content.get_tensor(name) for name in content.keys()}  # noqa: SIM118
    except SafetensorError as error:
        raise ValueError(
            f"{path} is corrupt ({error}); copy it again or train the network anew"
        ) from error
    if weights_hash(weights) != card.weights_sha256:
        raise ValueError(
            f"{path} is corrupt: its weights are not those that its card was written for; copy it "
            "again or train the network anew"
        )
    if _file_hash(graph) != card.graph_sha256:
        raise ValueError(
            f"{graph} is corrupt or belongs to other weights than {path.name} beside it; copy both "
            "again or train the network anew"
        )
    return card


def check_card(card: NetworkCard, *, sensor: str, camera: FisheyeCamera, source: Path) -> None:
    """Refuse a network that was trained for another sensor.

    Args:
        card: of the network.
        sensor: name of the sensor that is to use it.
        camera: of that sensor.
        source: the network's folder, for the message.

    Raises:
        ValueError: the network is for another sensor or another camera.
    """
    if card.sensor != sensor:
        raise ValueError(
            f"{source} was trained for the sensor {card.sensor!r}, not for {sensor!r}; train one "
            "for this sensor with dotsim_ros train-optics, or leave camera.residual empty"
        )
    if card.camera != camera_hash(camera):
        raise ValueError(
            f"{source} was trained for another camera of {sensor!r} (hash {card.camera}, this "
            f"camera's is {camera_hash(camera)}): its direction, lens or place has changed since; "
            "train the network anew with dotsim_ros train-optics, or leave camera.residual empty"
        )


def write_weights(path: Path, weights: Mapping[str, NDArray[Any]], card: NetworkCard) -> None:
    """Write weights and card as a safetensors file, whole or not at all."""
    arrays = {name: np.ascontiguousarray(array) for name, array in weights.items()}
    with whole_file(path) as part:
        part.write_bytes(save(arrays, metadata={CARD_KEY: card.text()}))
