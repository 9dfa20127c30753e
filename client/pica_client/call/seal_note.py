"""Why nothing is shown of somebody in an encrypted call, in the few words that fit under a name."""

from typing import Final

from pica_client.e2ee.status import PeerSeal, SealState

NOTES: Final = {
    SealState.WAITING: "",
    SealState.VERIFIED: "",
    SealState.PLAIN: "not encrypted",
    SealState.SECRET_DIFFERS: "secret differs: compare the secret files",
    SealState.RELABELLED: "not who the relay says it is",
    SealState.OTHER_VERSION: "encrypted by another version",
}
"""What is said of a state; `PeerSeal.reason` says it at length."""


def seal_note(seal: PeerSeal | None) -> str:
    """What is wrong with the encryption of a peer; empty when nothing is known to be."""
    return "" if seal is None else NOTES[seal.state]
