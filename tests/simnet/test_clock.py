import asyncio
import time

import pytest

from simnet.clock import (
    NothingScheduledError,
    TasksLeftError,
    VirtualTimeoutError,
    in_virtual_time,
    run_virtual,
)
from simnet.peers import now

pytestmark = pytest.mark.unit


@in_virtual_time
async def test_an_hour_of_sleep_ends_at_exactly_one_hour() -> None:
    for _ in range(3599):
        await asyncio.sleep(1)
    await asyncio.sleep(0.1 + 0.2)
    assert now() == 3599.3


@in_virtual_time
async def test_work_takes_no_time_of_the_processor_either() -> None:
    begin_s, begin_real_s = time.thread_time(), time.process_time()
    while time.process_time() < begin_real_s + 0.02:
        pass
    assert time.thread_time() == begin_s


def test_waiting_for_nothing_fails_instead_of_hanging() -> None:
    async def wait_for_nobody() -> None:
        await asyncio.get_running_loop().create_future()

    with pytest.raises(NothingScheduledError):
        run_virtual(wait_for_nobody())


def test_a_test_ends_at_the_limit() -> None:
    with pytest.raises(VirtualTimeoutError):
        run_virtual(asyncio.sleep(61), limit_s=60)


def test_a_task_left_behind_fails_the_test() -> None:
    async def leave_one() -> None:
        task = asyncio.create_task(asyncio.sleep(10))
        await asyncio.sleep(0)
        assert not task.done()

    with pytest.raises(TasksLeftError, match="1 tasks left"):
        run_virtual(leave_one())


@in_virtual_time
async def test_threads_are_refused() -> None:
    with pytest.raises(RuntimeError, match="no threads"):
        await asyncio.to_thread(print)
