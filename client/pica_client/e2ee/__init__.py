"""End-to-end encryption of media payloads in the manner of SFrame (RFC 9605).

The theory, the bytes and what is not protected stand in ``docs/privacy.md``.

    suites.py       the ciphers                         key, nonce, data -> data and tag
    frames.py       one payload                         payload + clear header <-> sealed payload
    padding.py      payloads of a few sizes only
    secret.py       the room secret and its file
    description.py  what a peer says of itself
    notes.py        the one message that peers exchange about keys
    peer_keys.py    what is held of keys, ours and of each peer, and which counters were seen
    keys.py         who has which key of whom (a pure state machine)
    status.py       who is verified, and the code to read aloud
    guard.py        all of it as one object for a `pica_client.transport.link.Link`

Needs the extra ``seal``, but for `status` and `padding`; nothing outside this folder imports more
unless a secret is given.
"""
