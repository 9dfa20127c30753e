"""End-to-end encryption of media payloads in the manner of SFrame (RFC 9605): docs/privacy.md.

    frames.py        one payload: payload + clear header <-> sealed payload; the replay window
    secret.py        the room secret and its file; who is verified, and the code to read aloud
    peer_keys.py     the one message that peers exchange about keys, and what was agreed with one
    guard.py         the key exchange of a room, and frames, for a `pica_client.transport.link.Link`

Only `secret` works without the extra ``seal``.
"""
