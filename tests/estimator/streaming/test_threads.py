"""Estimators in threads: one behind a lock, or one for each thread."""

from threading import Barrier, Lock, Thread

import numpy as np

from fed_estimators import assert_same, feed_all, remembered, short_log
from icreckon.estimator.log.measurements import TrackSpeeds
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.streaming.pose_estimator import PoseEstimator

ALPHA = load_robot("auriga-alpha")


def together(*functions):
    """Run functions in threads that start at the same time."""
    barrier, failed = Barrier(len(functions)), []

    def work(function):
        barrier.wait()
        try:
            function()
        except Exception as problem:
            failed.append(problem)

    threads = [Thread(target=work, args=(function,)) for function in functions]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failed


def test_threads_that_share_an_estimator_behind_a_lock_feed_as_one_thread_does():
    log, settings = short_log(duration=5.0), Settings(history=10.0)
    alone, shared = (PoseEstimator(ALPHA, settings=settings) for _ in range(2))
    feed_all(alone, log)
    measurements = list(log.measurements())
    shared.feed(measurements.pop(0))
    lock, read = Lock(), []

    def feed(wanted):
        for one in measurements:
            if isinstance(one, TrackSpeeds) is wanted:
                with lock:
                    shared.feed(one)
                    read.append(shared.snapshot())

    together(lambda: feed(True), lambda: feed(False))
    assert len(read) == len(measurements)
    assert all(np.isfinite(one.state).all() for one in read)
    assert_same(remembered(alone), remembered(shared))


def test_estimators_of_different_threads_are_independent():
    log = short_log(duration=5.0)
    alone, *others = (PoseEstimator(ALPHA) for _ in range(4))
    feed_all(alone, log)
    together(*(lambda one=one: feed_all(one, log) for one in others))
    for one in others:
        assert_same(remembered(alone), remembered(one))
