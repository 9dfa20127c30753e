"""The two ends of an avatar's stream, whichever format it uses.

A sender names its format in the track that it publishes: the hash of the avatar's stream profile,
or nothing for the plain 8-bit format, which every avatar can be sent in.
"""

from pica_core.avatar.file import Avatar
from pica_core.codec.latent_stream import LatentDecoder, LatentEncoder, StreamConfig
from pica_core.codec.plain_stream import PlainDecoder, PlainEncoder
from pica_core.errors import ProfileError

PLAIN = ""
"""The name of the plain format."""
FaceEncoder = LatentEncoder | PlainEncoder
FaceDecoder = LatentDecoder | PlainDecoder


def open_encoder(
    avatar: Avatar, config: StreamConfig, *, plain: bool = False
) -> tuple[FaceEncoder, str]:
    """The sending end, and the name of its format for the handshake.

    Args:
        plain: Use 8 bits a value even if the avatar has a stream profile.

    Raises:
        LatentError: A quality that the profile does not have.
    """
    profile = None if plain else avatar.stream_profile()
    if profile is None:
        return PlainEncoder(avatar.manifest.latent_scale), PLAIN
    return LatentEncoder(profile, config), profile.hash


def open_decoder(avatar: Avatar, name: str) -> FaceDecoder:
    """The receiving end, for the format as the sender names it.

    Raises:
        ProfileError: The sender uses tables that this avatar file does not hold.
    """
    if name == PLAIN:
        return PlainDecoder(avatar.manifest.latent_scale)
    profile = avatar.stream_profile()
    if profile is None or profile.hash != name:
        raise ProfileError(
            f"the stream is coded with profile {name[:8]}, this avatar file holds "
            f"{profile.hash[:8] if profile else 'none'}; get the sender's version of the file"
        )
    return LatentDecoder(profile)
