"""Which format a stream has, and that both ends agree on it before the first frame."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.stream_toy import STILL, other_profile, stream_avatar, toy_faces, toy_profile
from helpers.toy import make_toy_avatar
from pica_core.avatar.file import Avatar
from pica_core.avatar.streams import PLAIN, open_decoder, open_encoder
from pica_core.codec.latent_stream import LatentDecoder, LatentEncoder, StreamConfig
from pica_core.codec.plain_stream import PLAIN_BYTES
from pica_core.errors import LatentError, ProfileError

pytestmark = pytest.mark.unit

FACE = toy_faces(1, 1)[0]


def test_an_avatar_with_tables_is_sent_with_them_under_their_hash() -> None:
    encoder, name = open_encoder(stream_avatar(), StreamConfig())
    assert isinstance(encoder, LatentEncoder)
    assert name == toy_profile().hash
    assert isinstance(open_decoder(stream_avatar(), name), LatentDecoder)


@pytest.mark.parametrize("avatar", [make_toy_avatar(), stream_avatar()], ids=["without", "with"])
def test_every_avatar_can_be_sent_plain(avatar: Avatar) -> None:
    encoder, name = open_encoder(avatar, StreamConfig(), plain=True)
    assert name == PLAIN
    decoder = open_decoder(avatar, name)
    for number in (5, 3, 3, 60_000):  # each stands for itself, in any order
        frame = encoder.encode(FACE, STILL, STILL, number)
        assert frame is not None
        assert (len(frame.payload), frame.multiple) == (PLAIN_BYTES, 1)
        assert decoder.decode(frame.payload).latent == pytest.approx(FACE, abs=0.02)


def test_an_avatar_without_tables_is_sent_plain_by_itself() -> None:
    assert open_encoder(make_toy_avatar(), StreamConfig())[1] == PLAIN


def test_a_payload_of_the_other_format_is_an_error() -> None:
    coded, _ = open_encoder(stream_avatar(), StreamConfig())
    plain, _ = open_encoder(stream_avatar(), StreamConfig(), plain=True)
    for encoder, name in ((coded, PLAIN), (plain, toy_profile().hash)):
        frame = encoder.encode(FACE, STILL, STILL, 0)
        assert frame is not None
        with pytest.raises(LatentError):
            open_decoder(stream_avatar(), name).decode(frame.payload)


@pytest.mark.parametrize("name", [other_profile().hash, "0" * 64, "x", toy_profile().hash[:63]])
def test_a_stream_with_tables_that_we_do_not_have_is_refused_by_name(name: str) -> None:
    own = toy_profile().hash[:8]
    with pytest.raises(ProfileError, match=f"profile {name[:8]}, this avatar file holds {own}"):
        open_decoder(stream_avatar(), name)
    with pytest.raises(ProfileError, match="holds none; get the sender's version"):
        open_decoder(make_toy_avatar(), name)


def test_a_quality_that_the_avatar_does_not_have_is_refused() -> None:
    with pytest.raises(LatentError, match="quality is 12"):
        open_encoder(stream_avatar(), StreamConfig(quality=12))
    open_encoder(make_toy_avatar(), StreamConfig(quality=12))  # plain knows no qualities


def test_both_ends_work_on_arrays_as_they_come_from_a_file() -> None:
    tensors = {
        name: np.frombuffer(array.tobytes(), array.dtype).reshape(array.shape)
        for name, array in stream_avatar().tensors.items()
    }
    avatar = Avatar(stream_avatar().manifest, tensors)
    encoder, name = open_encoder(avatar, StreamConfig())
    frame = encoder.encode(FACE, STILL, STILL, 0)
    assert frame is not None
    assert open_decoder(avatar, name).decode(frame.payload).latent.shape == (8, 8, 4)
