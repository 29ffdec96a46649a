#!/bin/sh
# Sets MyoRK up on Debian 12 or Ubuntu 24.04 with nothing but python3 (root or sudo), then runs it.
#
#    sh setup.sh demo      from images to a muscle force, its reduced model and a report
#    sh setup.sh test      the tests marked core and slow, with what they need; all: test -m ""
#    sh setup.sh           the set-up only
#    sh setup.sh develop   the set-up only, with what tests, checks and the site need
#    sh setup.sh --help    these lines
#
# Further arguments go to the command: sh setup.sh test -k shape. What is there is used again;
# the package is installed anew when a source is newer than the last installation.
set -eu
cd "$(dirname "$0")"

packages="gcc g++ gfortran pkg-config python3-dev python3-venv ca-certificates
   libopenblas-openmp-dev libsuitesparse-dev libhdf5-dev libtomlplusplus-dev libmuparser-dev libssl-dev"
sources="meson.build meson_options.txt pyproject.toml fortran pydriver inputs"
stamp=.venv/installed # the list of the sources of the installation, newer than all of them
home=.venv/checkout   # the folder that the scripts of .venv point to
tools=.venv/tools     # exists where the needs of tests are installed
objects=.venv/build   # what is compiled, for the next build

say() { echo "setup: $*" >&2; }
fail() { say "$*"; exit 3; }

# Files only: Python's caches make folders newer. The list shows what was removed or renamed.
list_sources() {
   find $sources -name __pycache__ -prune -o -type f "$@" -print | sort
}

is_current() {
   has_venv && [ -f "$stamp" ] && { [ -z "$tests" ] || [ -f "$tools" ]; } &&
      [ "$(list_sources)" = "$(cat "$stamp")" ] &&
      [ -z "$(list_sources -newer "$stamp")" ]
}

# .venv is whole and was made here, not before the checkout was moved
has_venv() {
   [ -f "$home" ] && [ "$(cat "$home")" = "$PWD" ] && .venv/bin/python -c 'import pip' 2>/dev/null
}

# Python $1 can make environments and has the headers that compiled extensions need
is_whole_python() {
   "$1" - 2>/dev/null <<'END'
import ensurepip, os, sys, sysconfig, venv
headers = sysconfig.get_paths()["include"]
sys.exit(sys.version_info < (3, 10) or not os.path.exists(os.path.join(headers, "Python.h")))
END
}

# The first of them: what $PYTHON names, the first python3 on the PATH, the system's
find_python() {
   for candidate in ${PYTHON:-python3 /usr/bin/python3}; do
      if is_whole_python "$candidate"; then
         echo "$candidate"
         return
      fi
   done
   return 1
}

has_libraries() {
   for tool in gcc g++ gfortran pkg-config; do
      command -v "$tool" >/dev/null || return 1
   done
   echo '#include <suitesparse/SuiteSparseQR_C.h>' | gcc -E - >/dev/null 2>&1 &&
      pkg-config --exists openblas && pkg-config --exists tomlplusplus &&
      pkg-config --exists muparser && pkg-config --exists libcrypto &&
      { pkg-config --exists hdf5-serial || pkg-config --exists hdf5; }
}

# The tests look at pages in a real browser
has_browser() {
   command -v chromium >/dev/null || command -v chromium-browser >/dev/null ||
      command -v google-chrome >/dev/null
}

install_packages() {
   command -v apt-get >/dev/null ||
      fail "no apt-get here; install what these Debian packages hold: $(echo $*)"
   if [ "$(id -u)" = 0 ]; then
      as_root=
   elif command -v sudo >/dev/null; then
      as_root=sudo
   else
      fail "packages are missing; as root: apt-get install $(echo $*)"
   fi
   say "installing packages with apt (1-2 minutes)"
   apt="$as_root env DEBIAN_FRONTEND=noninteractive apt-get -qq -o DPkg::Lock::Timeout=300"
   # another apt-get, as the daily one, locks the lists, for which it does not wait
   { { $apt update || { sleep 30; $apt update; }; } &&
      $apt install -y --no-install-recommends "$@"; } >&2 </dev/null ||
      fail "apt-get failed, see above"
}

install_myork() {
   has_libraries && find_python >/dev/null || install_packages $packages
   has_libraries || fail "compilers or libraries are still missing after apt-get"
   if ! has_venv; then
      python=$(find_python) ||
         fail "no Python >= 3.10 with headers and venv (python3-dev, python3-venv) is found"
      rm -rf .venv
      "$python" -m venv .venv
      echo "$PWD" >"$home"
   fi
   if [ -f "$tools" ]; then tests=yes; fi
   say "building with $(.venv/bin/python --version) in .venv (one to three minutes)"
   list_sources >"$stamp.new" # before the build: a source saved meanwhile is newer
   tick &
   ticker=$!
   trap 'kill "$ticker" 2>/dev/null' EXIT
   # Python compiles what it imports, which is half of what is installed
   PIP_NO_COMPILE=1 .venv/bin/python -m pip install -q --disable-pip-version-check \
      --config-settings=build-dir=$objects ".${tests:+[test]}" </dev/null ||
      { rm -rf "$objects"; fail "the build failed, see above"; }
   kill "$ticker" 2>/dev/null
   trap - EXIT
   mv "$stamp.new" "$stamp"
   if [ -n "$tests" ]; then touch "$tools"; fi
}

# A line every twenty seconds while pip is silent
tick() {
   spent=0
   while sleep 20 </dev/null >/dev/null 2>&1; do
      spent=$((spent + 20))
      say "still building, $spent s"
   done
}

tests=
case ${1-} in
demo | '') ;;
test | develop) tests=yes ;;
-h | --help)
   sed -n '2,/^set /{s/^# \{0,1\}//p;}' setup.sh
   exit
   ;;
*)
   echo "usage: sh setup.sh [demo | test | develop | --help]" >&2
   exit 2
   ;;
esac

is_current || install_myork
export OMP_WAIT_POLICY="${OMP_WAIT_POLICY:-passive}"
case ${1-} in
demo)
   shift
   exec .venv/bin/myork demo "$@"
   ;;
test)
   shift
   has_browser || install_packages chromium
   # VTK draws without a screen
   .venv/bin/python -c 'import ctypes; ctypes.CDLL("libEGL.so.1")' 2>/dev/null || install_packages libegl1
   # side by side, a file of tests in one process, whatever OMP_NUM_THREADS is, which nproc looks at;
   # -m in "$@" replaces the one here
   exec .venv/bin/python -m pytest -n "$(env -u OMP_NUM_THREADS nproc)" --dist loadfile -m "not nightly" "$@"
   ;;
*) say "ready: .venv/bin/myork, .venv/bin/myork-solve" ;;
esac
