#!/bin/sh
# Makes sure of what pip cannot bring: OpenGL through EGL, with --venv PYTHON the venv module, with
# --nats the NATS server that the tests of several relays start for themselves, with --window an X server
# without a screen and a hand for it.
# Installs through apt-get when that is allowed, else prints the exact line and stops.
set -eu

packages=""
if [ "${1:-}" = "--venv" ]; then
    if ! "$2" -c 'import ensurepip, venv' 2>/dev/null; then
        packages="$("$2" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')"
    fi
elif [ "${1:-}" = "--nats" ]; then
    if ! command -v nats-server >/dev/null && [ ! -x /usr/sbin/nats-server ]; then
        packages="nats-server"
    fi
elif [ "${1:-}" = "--window" ]; then
    for program in Xvfb xdotool xprop; do
        command -v "$program" >/dev/null || packages="xvfb xdotool x11-utils"
    done
elif [ "$(uname -s)" = "Linux" ]; then
    libraries=$( (ldconfig -p || /sbin/ldconfig -p) 2>/dev/null || true)
    for library in libEGL.so.1 libGL.so.1; do
        case "$libraries" in
            *"$library"*) ;;
            *) packages="libegl1 libgl1 libegl-mesa0 libgl1-mesa-dri" ;;
        esac
    done
    case "$libraries" in
        *libEGL_mesa.so.0* | *libEGL_nvidia.so.0*) ;;
        *) packages="libegl1 libgl1 libegl-mesa0 libgl1-mesa-dri" ;;
    esac
fi
[ -n "$packages" ] || exit 0

if ! command -v apt-get >/dev/null; then
    echo "Missing system packages; install your system's counterparts of: $packages" >&2
    exit 1
fi
if [ "$(id -u)" = 0 ]; then
    as_root=""
elif command -v sudo >/dev/null && sudo -n true 2>/dev/null; then
    as_root="sudo"
else
    echo "Missing system packages. Run this, then try again:" >&2
    echo "    sudo apt-get update && sudo apt-get install -y --no-install-recommends $packages" >&2
    exit 1
fi
echo "Installing $packages" >&2
$as_root apt-get update -qq
# shellcheck disable=SC2086  # a list of words is meant
DEBIAN_FRONTEND=noninteractive $as_root apt-get install -y -qq --no-install-recommends $packages >&2
if [ "$packages" = "nats-server" ] && [ -d /run/systemd/system ]; then
    # The package starts one as a service; the tests need the program alone.
    $as_root systemctl disable --now nats-server >&2 || true
fi
