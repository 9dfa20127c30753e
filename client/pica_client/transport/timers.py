"""Waiting on an event loop, which may fire a timer up to its clock's resolution too early."""

import asyncio


def time_after(timer: float | None) -> float:
    """The loop's time after a timer fired: never before the timer's own."""
    now = asyncio.get_running_loop().time()
    return now if timer is None else max(now, timer)


async def wait_until(event: asyncio.Event, timer: float | None) -> float:
    """Wait until an event is set or its time has come, None is never; return the loop's time: at
    least `timer` if that ended the wait."""
    try:
        async with asyncio.timeout_at(timer):
            await event.wait()
    except TimeoutError:
        return time_after(timer)
    return asyncio.get_running_loop().time()


async def sleep_until(timer: float) -> float:
    """Wait until a time has come; return the loop's time, at least that. Costs less than a wait for
    an event that does not come."""
    await asyncio.sleep(max(timer - asyncio.get_running_loop().time(), 0.0))
    return time_after(timer)
