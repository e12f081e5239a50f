# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Networks of images: they learn what they can, go on after a kill, and refuse bad data."""

import os
import signal
import time
from dataclasses import replace

import numpy as np
import pytest
from optical_presses import film

torch = pytest.importorskip("torch", reason="training needs the extra 'learning'")
pytest.importorskip("torchvision", reason="training needs the extra 'learning'")

from dotsim_ros.learning.examples import make_examples  # noqa: E402
from dotsim_ros.learning.fitting import fit_network  # noqa: E402
from dotsim_ros.learning.networks import (  # noqa: E402
    LocalModel,
    make_network,
)
from dotsim_ros.learning.recipe import RECIPES  # noqa: E402
from dotsim_ros.learning.run import write_preview  # noqa: E402
from dotsim_ros.learning.training import (  # noqa: E402
    CHECKPOINT,
    NetworkTraining,
    TrainingProgress,
    batches,
)
from dotsim_ros.optics.picture import TITLE_HEIGHT_PX  # noqa: E402

FEW_EPOCHS = replace(RECIPES["ours"], epochs=4)


@pytest.fixture(scope="module")
def data():
    return film(width=64, press_count=4)


def psnr_db(images, measured):
    error = images.astype(float) - measured
    return 10.0 * np.log10(255.0**2 / np.mean(error**2))


def weights_of(fitted):
    return [value.numpy() for value in fitted.trained.network.state_dict().values()]


def equal(one, other):
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def test_a_tiny_model_beats_the_idle_and_the_carried_frame_on_presses_held_out():
    data = film(width=96, press_count=14)
    train, held_out = data.presses[:10], data.presses[10:]
    fitted = fit_network("ours", train, data.rest, data.camera)
    touched = slice(1, None)
    measured = np.stack([press.measured[touched] for press in held_out])
    images = np.stack([fitted.predict(press, data.rest)[touched] for press in held_out])
    warped = np.stack([press.warped[touched] for press in held_out])
    idle = np.broadcast_to(data.rest.idle, measured.shape)
    assert fitted.name == "ours"
    assert psnr_db(images, measured) > psnr_db(warped, measured) + 2.0
    assert psnr_db(images, measured) > psnr_db(idle, measured) + 6.0


def test_nothing_is_added_at_rest_or_outside_the_lit_disc(data):
    fitted = fit_network("ours", data.presses, data.rest, data.camera, recipe=FEW_EPOCHS)
    assert any(np.abs(array).max() > 0.0 for array in weights_of(fitted)[-2:])
    for press in data.presses:
        images = fitted.predict(press, data.rest)
        assert np.array_equal(images[0], data.rest.idle)
        assert not np.array_equal(images[-1], press.warped[-1])
        assert np.array_equal(images[:, ~data.rest.lit], press.warped[:, ~data.rest.lit])
    assert not data.rest.lit.all()


@pytest.mark.parametrize("kind", ["ours", "paper_direct", "paper_mobile", "unet"])
def test_every_kind_trains_and_predicts_images_of_the_measured_size(data, kind):
    # 9 touched or 13 frames: the last batch of 4 has one frame.
    press = data.presses[-1]
    shorter = replace(
        press,
        tip_depth_m=press.tip_depth_m[:1],
        measured=press.measured[:1],
        depth_m=press.depth_m[:1],
        normal=press.normal[:1],
        warped=press.warped[:1],
    )
    train = [*data.presses[:3], shorter]
    recipe = replace(RECIPES[kind], epochs=1, batch=4)
    told = []
    fitted = fit_network(
        kind, train, data.rest, data.camera, recipe=recipe, size=64, progress=told.append
    )
    images = fitted.predict(data.presses[0], data.rest)
    assert images.shape == data.presses[0].measured.shape
    assert images.dtype == np.uint8
    assert [progress.epoch for progress in told] == [1]
    assert np.isfinite(told[0].psnr_db)


def test_the_seed_decides_the_network(data):
    once, again, other = (
        fit_network("ours", data.presses, data.rest, data.camera, seed=seed, recipe=FEW_EPOCHS)
        for seed in (3, 3, 4)
    )
    assert equal(weights_of(once), weights_of(again))
    assert not equal(weights_of(once), weights_of(other))


class KilledError(Exception):
    pass


def small_training(data, directory=None) -> NetworkTraining:
    torch.manual_seed(5)
    return NetworkTraining(
        "ours",
        make_network("ours"),
        make_examples("ours", data.presses, data.rest, data.camera, (64, 48)),
        FEW_EPOCHS,
        directory=directory,
        checkpoint_interval_s=0.0,
    )


def test_a_training_takes_what_is_next_to_nothing_for_zero(data):
    def are_denormals_zero() -> bool:
        return (torch.tensor(1e-40) * 1.0).item() == 0.0

    # An ARM core, or an old PyTorch, may not be able to.
    can = torch.set_flush_denormal(True)
    torch.set_flush_denormal(False)
    seen = []
    small_training(data).run(lambda _: seen.append(are_denormals_zero()))
    assert seen == [can] * FEW_EPOCHS.epochs
    assert not are_denormals_zero()


def test_ctrl_c_ends_a_training_at_once(data):
    told = []

    def press_ctrl_c(progress: TrainingProgress) -> None:
        told.append(progress.epoch)
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(1.0)

    training = small_training(data)
    with pytest.raises(KeyboardInterrupt):
        training.run(press_ctrl_c)
    assert told == [1]
    # It can be gone on with.
    assert training.run().epochs == FEW_EPOCHS.epochs


def test_a_killed_training_goes_on_where_it_stopped(data, tmp_path):
    def die(progress: TrainingProgress) -> None:
        if progress.epoch == 2:
            raise KilledError

    with pytest.raises(KilledError):
        small_training(data, tmp_path).run(die)
    resumed = small_training(data, tmp_path)
    assert resumed.epoch == 2
    epochs = []
    broken = resumed.run(lambda progress: epochs.append(progress.epoch))
    whole = small_training(data).run()
    assert epochs == [3, 4]
    assert broken.psnr_db == whole.psnr_db
    assert equal(
        [value.numpy() for value in broken.network.state_dict().values()],
        [value.numpy() for value in whole.network.state_dict().values()],
    )
    # Nothing is left to do, and nothing changes.
    assert small_training(data, tmp_path).run().psnr_db == whole.psnr_db


def test_epochs_are_those_asked_for_and_the_learning_rate_falls_over_them(data):
    def fit(**options):
        return fit_network("ours", data.presses, data.rest, data.camera, **options).trained

    few = fit(epochs=4)
    assert few.epochs == len(few.psnr_db) == 4
    assert few.psnr_db == fit(recipe=FEW_EPOCHS).psnr_db
    assert few.psnr_db != fit(epochs=5).psnr_db[:4]


def test_the_state_of_another_training_is_refused_and_kept(data, tmp_path):
    def fit(seed):
        return fit_network(
            "ours",
            data.presses,
            data.rest,
            data.camera,
            seed=seed,
            recipe=FEW_EPOCHS,
            directory=tmp_path,
        )

    fit(0)
    before = (tmp_path / CHECKPOINT).read_bytes()
    with pytest.raises(ValueError, match="another folder"):
        fit(1)
    assert (tmp_path / CHECKPOINT).read_bytes() == before
    (tmp_path / CHECKPOINT).write_bytes(before[: len(before) // 2])
    fit(0)
    assert (tmp_path / f"{CHECKPOINT}.kept").read_bytes() == before[: len(before) // 2]


def test_bad_data_is_refused(data):
    def fit(kind="ours", presses=data.presses, rest=data.rest, **options):
        fit_network(kind, presses, rest, data.camera, **options)

    with pytest.raises(ValueError, match="none of ours, paper"):
        fit(kind="resnet")
    with pytest.raises(ValueError, match="8 frames in 2 presses, expected 10"):
        fit(presses=data.presses[:2])
    narrow = replace(data.presses[0], measured=data.presses[0].measured[:, :, :-2])
    with pytest.raises(ValueError, match=r"dent_0: measured images have shape"):
        fit(presses=[narrow, *data.presses[1:]])
    other = replace(data.rest, idle=data.rest.idle[:-2])
    with pytest.raises(ValueError, match=r"idle frame is 64x46, expected 64x48"):
        fit(rest=other)
    with pytest.raises(ValueError, match="size is 128"):
        fit(size=128)
    with pytest.raises(ValueError, match="epochs is 0, expected 1 or more"):
        fit(epochs=0)
    untouched = [
        replace(press, depth_m=np.broadcast_to(press.depth_m[:1], press.depth_m.shape))
        for press in data.presses
    ]
    with pytest.raises(ValueError, match="in none of"):
        fit(presses=untouched)


def test_lone_frames_join_the_batch_before():
    assert [len(part) for part in batches(torch.arange(9), 4)] == [4, 5]
    assert [len(part) for part in batches(torch.arange(8), 4)] == [4, 4]
    assert [len(part) for part in batches(torch.arange(1), 4)] == [1]


def test_the_local_model_is_linear_in_what_it_is_given_to_change(data):
    """A gain alone brightens the warped image in proportion."""
    examples = make_examples("ours", data.presses, data.rest, data.camera, (64, 48))
    model = LocalModel().eval()
    with torch.no_grad():
        model.head.bias[:12] = 0.1
        image = examples.image[3]
        added = model(examples.frame[3:4], examples.rest, image[None])[0].numpy()
    rows, columns = np.mgrid[0:48, 0:64]
    inside = np.hypot(columns - 31.5, rows - 23.5) < 15.0
    image = image.numpy()
    ratio = (added / np.maximum(image, 1e-6))[:, inside & (image.min(axis=0) > 0.1)]
    assert ratio.mean() == pytest.approx(0.1, rel=0.05)
    assert ratio.std() < 1e-3


def test_the_preview_shows_a_row_for_each_press(data, tmp_path):
    write_preview(tmp_path / "preview.png", data.presses, [p.warped for p in data.presses], rows=3)
    import cv2

    sheet = cv2.imread(str(tmp_path / "preview.png"))
    assert sheet.shape == (3 * (48 + TITLE_HEIGHT_PX), 5 * 64, 3)
