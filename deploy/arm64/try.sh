#!/usr/bin/env bash
# Tries zmav on arm64 without an arm64 computer: makes a Debian of that kind, and has QEMU run its programs one by one in
# it. deploy/install.sh, the README's two commands as far as they go there, and the core's tests. Slow: an hour or more.
# docs/install.md says what came of it.
set -euo pipefail

TREE=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
ROOT=/var/tmp/zmav-arm64
MIRROR="" SUITE=bookworm STEPS="install demo tests live"
PACKAGES=ca-certificates,make,passwd,python3,python3-venv,systemd,udev,util-linux
QEMU=qemu-aarch64
# The core's: frames, signing, files, keys, configuration, proofs, bounds.
TESTS=(tests/mavlink tests/formats tests/trust tests/test_config.py tests/test_geo.py tests/test_keys.py tests/test_wire.py
    tests/services/authority/test_bounds.py tests/services/authority/test_limits.py
    tests/services/authority/test_trajectory.py tests/services/params/test_values.py)
# Those of sessions, links and flights, whose times are real ones: on a busy computer some may be late.
LIVE=(tests/test_session.py tests/test_adapter.py tests/test_zenoh_codec.py tests/services/orders/test_flight.py)

usage() {
    cat <<HELP
usage: sudo deploy/arm64/try.sh [--root DIR] [--mirror URL] [--suite NAME] [STEP...]

  STEP          install, demo, tests, live: those alone  (default: all, in this order)
  --root DIR    where the arm64 system is made, and kept for the next time  (default: $ROOT)
  --mirror URL  Debian's packages  (default: where this computer has its own from)
  --suite NAME  which Debian  (default: $SUITE)

Needs: apt-get install debootstrap qemu-user-static binfmt-support
HELP
}

say() { printf '==> %s\n' "$*"; }
fail() { printf 'try.sh: %s\n' "$*" >&2; exit 1; }

check_host() {
    [ "$(id -u)" = 0 ] || fail "needs root: sudo $0"
    for each in debootstrap unshare chroot; do
        command -v "$each" >/dev/null || fail "there is no $each: apt-get install debootstrap qemu-user-static binfmt-support"
    done
    [ "$(uname -m)" != aarch64 ] || return 0
    local kernel=/proc/sys/fs/binfmt_misc
    [ -e "$kernel/register" ] || mount -t binfmt_misc binfmt_misc "$kernel" ||
        fail "this kernel cannot be told of foreign programs: $kernel cannot be mounted"
    [ -e "$kernel/$QEMU" ] || update-binfmts --enable "$QEMU" || fail "QEMU is not known to the kernel: see above"
    # Without this flag the kernel would look for QEMU within the other root.
    grep -q '^flags:.*F' "$kernel/$QEMU" || fail "$kernel/$QEMU lacks the flag F: install qemu-user-static"
}

# Debian's own mirror as apt has it: never one of the other archives that may be set up.
own_mirror() {
    # Dollar signs are apt's.
    # shellcheck disable=SC2016
    apt-get indextargets --format '$(ORIGIN) $(CODENAME) $(COMPONENT) $(REPO_URI)' 'Created-By: Packages' |
        awk '$1 == "Debian" && $3 == "main" { print $4; exit }'
}

make_root() {
    [ ! -e "$ROOT/.made" ] || return 0
    MIRROR=${MIRROR:-$(own_mirror)}
    [ -n "$MIRROR" ] || fail "apt here has no mirror of Debian: give one with --mirror"
    say "making a Debian $SUITE for arm64 in $ROOT"
    [ -z "$(ls -A "$ROOT" 2>/dev/null)" ] || [ -e "$ROOT/.zmav" ] || fail "$ROOT holds something else: name another with --root"
    rm -rf --one-file-system "$ROOT"
    mkdir -p "$ROOT"
    touch "$ROOT/.zmav"
    debootstrap --arch=arm64 --variant=minbase --include="$PACKAGES" "$SUITE" "$ROOT" "$MIRROR" >"$ROOT.log" 2>&1 ||
        fail "debootstrap: $(tail -n 3 "$ROOT.log")"
    touch "$ROOT/.made"
}

# What the network here needs to be trusted and found: it is this computer's that is used.
lend_settings() {
    cp --remove-destination /etc/resolv.conf "$ROOT/etc/resolv.conf"
    cp /etc/ssl/certs/ca-certificates.crt "$ROOT/etc/ssl/certs/ca-certificates.crt"
    if [ -f /etc/pip.conf ]; then cp /etc/pip.conf "$ROOT/etc/pip.conf"; fi
    rm -rf "$ROOT/src"
    mkdir "$ROOT/src"
    tar -C "$TREE" -cf - --exclude=./.git --exclude=./.venv --exclude='*_cache' --exclude=__pycache__ . | tar -C "$ROOT/src" -xf -
}

# Runs its words by the other root's shell, in namespaces that end with it: nothing stays mounted, nothing runs on.
enter() {
    # shellcheck disable=SC2016
    unshare --mount --pid --fork --kill-child --propagation private bash -c '
        set -e
        mount -t proc proc "$0/proc"
        mount --rbind /dev "$0/dev"
        mount -t tmpfs tmpfs "$0/run"
        mount -t tmpfs -o mode=1777 tmpfs "$0/tmp"
        exec chroot "$0" /usr/bin/env -i PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LANG=C.UTF-8 \
            PIP_CERT=/etc/ssl/certs/ca-certificates.crt ${PIP_INDEX_URL:+"PIP_INDEX_URL=$PIP_INDEX_URL"} \
            ${https_proxy:+"https_proxy=$https_proxy"} PIP_DEFAULT_TIMEOUT=180 sh -ec "$1"' "$ROOT" "$*"
}

RESULTS=()
step() { # WHAT COMMAND...
    local what=$1 began=$SECONDS verdict=passed; shift
    say "$what"
    enter "cd /src; $*" 2>&1 | tee "$ROOT.said" | sed -u 's/^/    /' || verdict=FAILED
    RESULTS+=("$(printf '%-7s %5d s  %s: %s' "$verdict" "$((SECONDS - began))" "$what" "$(tail -n 1 "$ROOT.said")")")
}

try_install() {
    step "deploy/install.sh" "deploy/install.sh --name quad1 --fleet alpha --link tcp:127.0.0.1:5760"
    step "deploy/install.sh --check" "deploy/install.sh --check"
    step "the vehicle's service by hand, heard by zmav ls" '
        zmav sim --copters 1 >/dev/null & sleep 20
        runuser -u zmav -- env HOME=/var/lib/zmav zmav up --file /etc/zmav/vehicle.toml --name quad1 >/tmp/up.log 2>&1 &
        for again in 1 2 3 4 5 6; do zmav ls --fleet alpha --wait 20 | tee /tmp/ls; ! grep -q quad1 /tmp/ls || exit 0; done
        cat /tmp/up.log; exit 1'
    step "deploy/install.sh --uninstall --purge" "deploy/install.sh --uninstall --purge"
    RESULTS+=("skipped          the units' start, watchdog and way back, and udev: systemd does not run in this root")
}

try_demo() {
    step "make .venv/.demo (what 'make demo' installs)" "make .venv/.demo"
    step "make demo" "timeout 1800 make demo"
}

try_tests() {
    step "make .venv/.dev (all of requirements.lock that 'make test' installs)" "make .venv/.dev"
    step "the core's tests" ".venv/bin/python -m pytest -q -n 0 -p no:cacheprovider --timeout 1800 ${TESTS[*]}"
}

try_live() {
    step "make .venv/.dev" "make .venv/.dev"
    step "tests with sessions" ".venv/bin/python -m pytest -q -n 0 -p no:cacheprovider --timeout 600 ${LIVE[*]}"
}

CHOSEN=""
while [ $# -gt 0 ]; do
    case $1 in
        --root|--mirror|--suite)
            [ $# -ge 2 ] || fail "$1 wants a value: see --help"
            case $1 in --root) ROOT=$2 ;; --mirror) MIRROR=$2 ;; --suite) SUITE=$2 ;; esac
            shift ;;
        -h|--help) usage; exit 0 ;;
        install|demo|tests|live) CHOSEN="$CHOSEN $1" ;;
        *) usage >&2; exit 2 ;;
    esac
    shift
done
check_host
make_root
lend_settings
# shellcheck disable=SC2016
say "$(enter '. /etc/os-release; echo "$PRETTY_NAME, $(uname -m), $(python3 -V), $(ldd --version | sed -n 1p)"')"
[ "$(uname -m)" = aarch64 ] || say "$(qemu-aarch64-static --version | head -n 1)"
for each in ${CHOSEN:-$STEPS}; do "try_$each"; done
say "$(date -u +%F), $(git -C "$TREE" describe --always --dirty 2>/dev/null || echo 'no commit'):"
printf '    %s\n' "${RESULTS[@]}"
! printf '%s\n' "${RESULTS[@]}" | grep -q '^FAILED'
