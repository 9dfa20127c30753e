"""The relay's TLS certificate: read from files, and read again while connections go on.

A connection keeps the certificate that it began with; one that begins later gets the new one. New
files are tried out first: what cannot be used never replaces what can.
"""

import ssl
from pathlib import Path

from pica_server.errors import ConfigurationError

_Stamp = tuple[tuple[int, int, int], ...]


class Certificate:
    """A certificate with its key, and the TLS settings of a relay.

    Attributes:
        context: What connections begin with.
    """

    def __init__(self, cert: Path, key: Path) -> None:
        """Read the files.

        Args:
            cert: The certificate and those between it and a root, in PEM format.
            key: Its private key in PEM format, without a password.

        Raises:
            ConfigurationError: One of them cannot be used; one line with the flag and the fix.
        """
        self._cert, self._key = cert, key
        self._stamp = self._look()
        self.context = _context(cert, key)

    def has_changed(self) -> bool:
        """Return True if the files are others than those that were last read, or tried."""
        return self._look() != self._stamp

    def reload(self) -> None:
        """Read the files again; if that raises, as at first, the old certificate stays."""
        self._stamp = self._look()
        _context(self._cert, self._key)
        self.context.load_cert_chain(self._cert, self._key, password=_no_password)

    def _look(self) -> _Stamp:
        stamps = []
        for path in (self._cert, self._key):
            try:
                status = path.stat()
            except OSError:
                stamps.append((0, 0, 0))  # being replaced
            else:
                stamps.append((status.st_ino, status.st_mtime_ns, status.st_size))
        return tuple(stamps)


def _context(cert: Path, key: Path) -> ssl.SSLContext:
    for flag, path in (("tls-cert", cert), ("tls-key", key)):
        try:
            text = path.read_bytes()
        except OSError as error:
            raise ConfigurationError(f"--{flag} {path}: {error.strerror}") from error
        if b"-----BEGIN " not in text:
            raise ConfigurationError(f"--{flag} {path}: it is no PEM file")
        if flag == "tls-key" and b"ENCRYPTED" in text:
            fix = "a relay cannot ask for a password: `openssl pkey` takes it off"
            raise ConfigurationError(f"--{flag} {path}: it is encrypted, and {fix}")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.set_alpn_protocols(["http/1.1"])
    try:
        context.load_cert_chain(cert, key, password=_no_password)
    except ssl.SSLError as error:
        if error.reason == "KEY_VALUES_MISMATCH":
            raise ConfigurationError(f"--tls-key {key}: it is not the key of {cert}") from error
        reason = (error.reason or "unreadable").replace("_", " ").lower()
        raise ConfigurationError(
            f"--tls-cert {cert}: it or its key {key} cannot be used: {reason}"
        ) from error
    return context


def _no_password() -> str:
    """Keep OpenSSL from asking on the terminal."""
    return ""
