# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One sensor in two threads: right forces, or an error that says what to do."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from dotsim_ros import Pose, TactileSensor

POSES = [Pose((0.001 * k, 0.0, 0.0039 - 0.0002 * k)) for k in range(4)]


@pytest.fixture(scope="module")
def sensor():
    return TactileSensor.load("flat_pad")


def forces_n(sensor):
    sensor.reset()
    return [float(sensor.press(pose).wrench.force_n[2]) for pose in POSES]


def test_two_threads_that_press_one_sensor_get_right_forces_or_an_error(sensor):
    right = forces_n(sensor)
    together = threading.Barrier(2)

    def found(_thread):
        together.wait()
        answers = []
        for _ in range(4):
            try:
                answers.append(forces_n(sensor))
            except RuntimeError as error:
                answers.append(str(error))
        return answers

    with ThreadPoolExecutor(2) as threads:
        answers = [answer for part in threads.map(found, range(2)) for answer in part]
    assert all(answer == right or "make one for each thread" in answer for answer in answers)


def test_a_call_during_one_of_another_thread_is_refused_and_changes_nothing(sensor):
    right = forces_n(sensor)
    with ThreadPoolExecutor(1) as other:
        with sensor.exclusive_use.call(begins=True):
            refused = other.submit(sensor.step, POSES[0])
            with pytest.raises(RuntimeError, match="is in a call of another thread"):
                refused.result()
            assert forces_n(sensor) == right
        # The two have no lock: this may come between two calls of the other.
        with pytest.raises(RuntimeError, match="was reset by another thread"):
            other.submit(sensor.press, POSES[0]).result()
        assert other.submit(forces_n, sensor).result() == right


def test_threads_that_take_turns_with_a_lock_share_a_sensor():
    sensor = TactileSensor.load("flat_pad")
    right = forces_n(sensor)
    sensor.reset()
    with ThreadPoolExecutor(1) as other:
        turns = [other.submit(sensor.press, pose).result() for pose in POSES[:2]]
        turns += [sensor.press(pose) for pose in POSES[2:]]
    assert [float(frame.wrench.force_n[2]) for frame in turns] == right
