import pytest

from helpers.members import hub_with
from pica_protocol.frames import Frame, encode_frame, media_message
from pica_server.room.connections import CALM_S, LATE_S, Overload

pytestmark = pytest.mark.unit


def test_one_late_turn_sheds_and_two_in_a_row_refuse_newcomers_for_a_while() -> None:
    overload = Overload()
    overload.note_turn(LATE_S, now=1.0)
    assert overload.sheds
    assert not overload.refuses(1.0)
    overload.note_turn(LATE_S, now=1.1)
    assert overload.refuses(1.1)
    overload.note_turn(0.0, now=1.2)
    assert not overload.sheds
    assert not overload.refuses(1.1 + CALM_S)


def test_of_faces_that_came_together_a_late_relay_passes_on_the_newest_of_each_stream() -> None:
    hub, (ada, bob) = hub_with("Ada", "Bob")

    def face(sequence: int) -> bytes:
        frame = Frame(stream=ada.stream, sequence=sequence, captured_us=0, payload=b"face")
        return media_message([encode_frame(frame)])

    hub.overload.note_turn(LATE_S, now=1.0)
    hub.receive(ada.connection, [face(0), face(1), face(2)], 1.0)
    assert [frame.sequence for frame in bob.listen(1.0) if isinstance(frame, Frame)] == [2]
    assert hub.stats.dropped == {"late": 2}


def test_a_relay_that_others_keep_from_the_processor_lets_newcomers_in() -> None:
    overload = Overload()
    for number in range(4):
        overload.note_turn(LATE_S, now=1.0 + number, worked=0.2)
    assert overload.sheds
    assert not overload.refuses(4.0)
