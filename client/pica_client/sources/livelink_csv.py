"""Recordings of the Live Link Face app as sources.

Head angles are radians about the head's own axes (+x the subject's left, +y up, +z out of the
face). Only the order of magnitude could be checked on a real file (the recordings we have were made
with head tracking off): that yaw turns about +y, pitch about +x and roll about +z, right-handed and
in this order from the outside in, is our assumption.
"""

from pathlib import Path

import numpy as np

from pica_client.errors import SourceError
from pica_client.output import say
from pica_client.sources.live.live_face import VALUE_LIMIT
from pica_client.sources.rotation import rotation_vector_from_yaw_pitch_roll
from pica_client.sources.source import Recording
from pica_core.errors import CaptureError
from pica_core.livelink import DAY_S, TIMECODE_FPS, read_livelink_csv


def load_livelink_csv(path: Path, *, start_s: float = 0.0) -> Recording:
    """Read a Live Link Face recording, at its own clock.

    Args:
        path: The ``.csv`` file of a take.
        start_s: Where in the recording the source begins, seconds.

    Returns:
        The looping recording. Lines without a face are moments without one, and so are those with
        values that are no numbers; of the latter the user is told.

    Raises:
        SourceError: It cannot be read, time runs backwards, or there is never a face.
    """
    try:
        take = read_livelink_csv(path)
    except CaptureError as error:
        raise SourceError(str(error)) from error
    count = len(take.clock_s)
    if take.num_lost:
        say(f"{path}: {take.num_lost} of {count} frames are lost, they hold NaN or infinity")
    if not take.has_face.any():
        raise SourceError(f"{path}: no frame holds a face and numbers alone; record the take again")
    beyond = np.abs(np.concatenate((take.arkit, take.angles), axis=1)).max(axis=1) > VALUE_LIMIT
    if beyond.any():
        line = int(np.argmax(beyond)) + 2
        raise SourceError(f"{path}, line {line}: a value lies outside ±{VALUE_LIMIT:g}")
    steps_s = np.diff(take.clock_s)
    steps_s[steps_s < -DAY_S / 2] += DAY_S  # past midnight
    if np.any(steps_s <= 0):
        line = int(np.argmax(steps_s <= 0)) + 3
        raise SourceError(f"{path}, line {line}: its timecode does not come after the line before")
    return Recording(
        times_s=np.concatenate(([0.0], np.cumsum(steps_s))),
        arkit=take.arkit.astype(np.float32),
        rotation=rotation_vector_from_yaw_pitch_roll(take.angles),
        translation_m=np.zeros((count, 3), np.float32),
        has_face=take.has_face,
        loop_gap_s=float(np.median(steps_s)) if len(steps_s) else 2 / TIMECODE_FPS,
        start_s=start_s,
    )
