"""End-to-end encryption of media payloads in the manner of SFrame (RFC 9605): docs/privacy.md.

    frames.py        one payload: payload + clear header <-> sealed payload; the replay window
    secret.py        the room secret and its file
    key_messages.py  the one message that peers exchange about keys
    peer_keys.py     what was agreed with one peer, and how its encryption stands
    guard.py         the key exchange of a room, and frames, for a `pica_client.transport.link.Link`
    status.py        who is verified, and the code to read aloud

Only `status` and `secret` work without the extra ``seal``.
"""
