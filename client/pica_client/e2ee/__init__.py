"""End-to-end encryption of media payloads in the manner of SFrame (RFC 9605).

The theory, the bytes and what is not protected stand in ``docs/privacy.md``.

    suites.py   the ciphers                         key, nonce, data -> data and tag
    frames.py   one payload                         payload + clear header <-> sealed payload
    replay.py   which counters have been seen
    secret.py   the room secret and its file
    notes.py    the one message that peers exchange about keys
    keys.py     who has which key of whom (a pure state machine)
    guard.py    all of it as one object for a `pica_client.transport.link.Link`

Needs the extra ``seal``; nothing outside this folder imports it unless a secret is given.
"""
