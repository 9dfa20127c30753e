"""The relay: forwards media frames between the peers of a room and never opens a payload.

``room``, ``outbox``, ``stats`` and ``hub`` decide, without socket or clock; ``relay`` is the shell
around them and ``commands`` is ``pica relay``.
"""
