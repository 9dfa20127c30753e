#!/bin/sh
# Installs the parts that run alone in fresh environments, and starts them there.
#
#     base     `pica relay` starts, and neither numpy nor torch is installed
#     cluster  with it, and without numpy, the relay's way to NATS imports
#     view     every module of `pica_client` imports, and torch, SciPy and cryptography are not there;
#              only those of `pica_client.e2ee` need the extra seal, and the benches the extra bench
#     seal     with it, a sender's install imports them too
#
# The first three grow in one environment, as none may have what a later one brings. Both are
# temporary; wheels come from pip's cache when it has them.
set -eu

own=.venv/bin/python
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
import="
import importlib, pkgutil, sys
inside, left_out = sys.argv[1], tuple(sys.argv[2:])
name = inside.partition('.')[0]
found = pkgutil.walk_packages(importlib.import_module(name).__path__, name + '.')
names = [n for _, n, _ in found if n.startswith(inside) and not n.startswith(left_out or '-')]
[importlib.import_module(n) for n in names]
print(len(names), 'modules of', inside, 'import')
"

install() {
    "$python" -m pip --disable-pip-version-check install --quiet \
        --constraint constraints.txt "$wheel$1"
}

absent() {
    for module; do
        if "$python" -I -c "import $module" 2>/dev/null; then
            echo "$module is installed for $python" >&2
            exit 1
        fi
    done
}

"$own" -m pip --disable-pip-version-check wheel --quiet --no-deps --wheel-dir "$work" .
wheel="$(echo "$work"/*.whl)"
python="$work/base/bin/python"
"$own" -m venv "$work/base"
install ""
absent numpy torch onnxruntime moderngl
"$python" -I -m pica_command relay --port 0 --ready-file "$work/ready" 2>/dev/null &
relay=$!
while [ ! -e "$work/ready" ] && kill -0 $relay 2>/dev/null; do sleep 0.1; done
kill $relay
wait $relay
echo "base: the relay runs without numpy"
install "[cluster]"
absent numpy torch
"$python" -I -c "$import" pica_server.placement.bucket
install "[view]"
absent torch scipy cryptography
"$python" -I -c "$import" pica_client pica_client.e2ee. pica_client.bench. pica_client.cli.bench

python="$work/sender/bin/python"
"$own" -m venv "$work/sender"
install "[send,seal]"
absent torch onnxruntime moderngl
"$python" -I -c "$import" pica_client.e2ee
