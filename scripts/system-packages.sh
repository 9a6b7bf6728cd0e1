#!/bin/sh
# Makes sure the system has what a task needs: installs with apt where permitted, else names the exact command.
#   system-packages.sh host   compiler and Python headers (native boards, C extensions of the codec)
#   system-packages.sh avr    the AVR toolchain, the Arduino core, avrdude and simavr as well
#   system-packages.sh flash  avrdude and what builds the images
# PYTHON names the interpreter (default python3).
set -eu
PYTHON=${PYTHON:-python3}
missing=""
need() { # need PACKAGE TEST...: note PACKAGE when TEST fails
  package=$1
  shift
  "$@" >/dev/null 2>&1 || missing="$missing $package"
}
python_headers() {
  "$PYTHON" -c 'import pathlib, sys, sysconfig; sys.exit(not (pathlib.Path(sysconfig.get_path("include")) / "Python.h").exists())'
}
arduino_core() { test -f /usr/share/arduino/hardware/arduino/avr/cores/arduino/Arduino.h; }
header() { test -f "/usr/include/$1"; }

if ! "$PYTHON" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
  echo "TIGER needs Python 3.11 or newer as '$PYTHON'; set PYTHON=/path/to/python3.11" >&2
  exit 1
fi
need gcc command -v gcc
need g++ command -v g++
need python3-dev python_headers
need python3-venv "$PYTHON" -c 'import ensurepip, venv'
case "${1:-host}" in
  host) ;;
  flash | avr)
    need gcc-avr command -v avr-gcc
    need binutils-avr command -v avr-objcopy
    need avr-libc test -d /usr/lib/avr/include/avr
    need arduino-core-avr arduino_core
    need avrdude command -v avrdude
    if [ "$1" = avr ]; then
      need libsimavr-dev header simavr/sim_avr.h
      need libelf-dev header libelf.h
    fi
    ;;
  *)
    echo "usage: $0 host|avr|flash" >&2
    exit 2
    ;;
esac
[ -n "$missing" ] || exit 0

command="apt-get install -y --no-install-recommends$missing"
if ! command -v apt-get >/dev/null 2>&1; then
  echo "missing:$missing (Debian's names). Install them with this system's package manager, then run make again." >&2
  exit 1
elif [ "$(id -u)" = 0 ]; then
  sudo=""
elif sudo -n true 2>/dev/null; then
  sudo="sudo"
else
  echo "System packages are missing. Run this, then make again:" >&2
  echo "    sudo apt-get update && sudo $command" >&2
  exit 1
fi
echo "Installing system packages:$missing"
export DEBIAN_FRONTEND=noninteractive
$sudo apt-get update -q >/dev/null
# shellcheck disable=SC2086
$sudo $command -q >/dev/null
