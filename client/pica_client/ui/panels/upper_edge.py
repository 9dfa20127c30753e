"""The upper edge of the picture: the signs of the call, and how much of the height they and the
statistics below them take."""

from pica_client.call.participants import duration_text, joined_names, recorders
from pica_client.ui.call_view import CallView
from pica_client.ui.panels.control_bar import EDGE_PT
from pica_client.ui.state import ViewState
from pica_client.ui.surface import icons
from pica_client.ui.surface.theme import SMALL_PT, Metrics, Tone

SIGN_PT = 36.0
"""Height of a sign with the gap below it."""
MAX_ROWS = 16
"""Participants that the table of statistics shows."""
MAX_TABLE_SHARE = 0.45
"""Part of the picture's height that the table takes at most."""
Line = tuple[str, Tone]


def call_signs(call: CallView) -> list[Line]:
    """Where one is and for how long, whether faces are encrypted, and who keeps what is seen."""
    status = call.status
    if not status.room:
        return []
    lock = f"{icons.LOCK}  " if status.is_encrypted else ""
    where = f"{lock}{status.room}   {duration_text(status.duration_s)}"
    found: list[Line] = [(where, "good" if status.is_connected else "alert")]
    names = recorders(each for each in status.participants if not each.is_self)
    if names:
        verb = "records" if len(names) == 1 else "record"
        found.append((f"{joined_names(names)} {verb}", "alert"))
    return found


def signs_share(state: ViewState, call: CallView, metrics: Metrics) -> float:
    """The part of the picture's height that the signs at the upper left take from the people."""
    num_lines = len(call_signs(call))
    if metrics.is_compact:
        num_lines = min(num_lines + state.is_recording, 1)
    return metrics.px(SIGN_PT * num_lines) / metrics.size[1]


def statistics_share(state: ViewState, call: CallView, metrics: Metrics) -> float:
    """The part of the picture's height that the table takes from the people."""
    if not state.show_statistics:
        return 0.0
    edge_px = metrics.px(EDGE_PT)
    rows = min(len(call.people), MAX_ROWS) + 2
    table_px = rows * metrics.px(1.35 * SMALL_PT + 6) + edge_px
    table_px = min(table_px, MAX_TABLE_SHARE * metrics.size[1])
    return (table_px + edge_px) / metrics.size[1] + signs_share(state, call, metrics)
