"""Ask the relay of this container whether it is well; exit status 0 or 1.

It looks at the same variables as the relay: PICA_RELAY_PORT, and PICA_RELAY_TLS_CERT, of which only
the presence counts. The certificate is not checked: this is the same machine.
"""

import os
import ssl
import sys
import urllib.error
import urllib.request

TIMEOUT_S = 2


def main() -> int:
    """Return the exit status."""
    port = os.environ.get("PICA_RELAY_PORT") or "8765"
    scheme = "https" if os.environ.get("PICA_RELAY_TLS_CERT") else "http"
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    proxies = urllib.request.ProxyHandler({})  # none of the environment's
    opener = urllib.request.build_opener(proxies, urllib.request.HTTPSHandler(context=context))
    url = f"{scheme}://127.0.0.1:{port}/healthz"
    try:
        with opener.open(url, timeout=TIMEOUT_S) as reply:
            return 0 if reply.status == 200 else 1
    except (urllib.error.URLError, OSError) as error:
        print(f"{url}: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
