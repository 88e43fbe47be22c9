#!/usr/bin/env bash
# One agent a vehicle: a service user, an environment under /opt/zmav, /etc/zmav, a udev rule and systemd's units.
# Installs from the tree it stands in. docs/install.md is the guide; 'deploy/install.sh --help' lists the options.
set -euo pipefail

TREE=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
SELF=${ZMAV_INSTALLER:-$0}  # 'zmav install' where pip has installed it
OPT=/opt/zmav
ETC=/etc/zmav
STATE="/var/lib/zmav /var/lib/zmav-agent"
UNITS=/etc/systemd/system
RULES=/etc/udev/rules.d/70-zmav-autopilot.rules
COMMAND=/usr/local/bin/zmav
LOCK=/run/zmav-install  # not in /run/lock, where anybody may put a link of that name
VEHICLE=zmav-vehicle.service
ROS2=zmav-ros2.service  # ends at once where the fleet file's [ros2] does not ask for it
MARK="zmav service"     # in the users' comment: those that have it are ours to remove
SETTLE=15               # s that a new service must run on in one process: longer than its watchdog

# Those of pyproject.toml, but for what develops zmav.
extras_there() {
    sed -n '/^\[project.optional-dependencies\]/,/^\[project.scripts\]/ s/^\([a-z0-9]*\) = .*/\1/p' "$TREE/pyproject.toml" |
        grep -vxE 'build|site|all|dev' | paste -sd, - | sed 's/,/, /g'
}

usage() {
    cat <<HELP
usage: sudo $SELF [options]     install, or upgrade to the version that this is
       sudo $SELF --check       look at what is installed; 1 where something is wrong
       sudo $SELF --uninstall   remove all but /etc/zmav and kept files; with --purge these, too

  --name NAME               the vehicle's name in the fleet (first installation: quad1)
  --fleet NAME              its fleet's (first installation: demo)
  --link URL                its autopilot (first installation: /dev/autopilot)
  --fleet-file FILE         in the place of the template: a fleet file that has the vehicle
  --credentials DIR         what 'zmav mesh ca issue NAME --role vehicle' made
  --agent-credentials DIR   the same for the agents on board, of the role planner
  --extras LIST             what agents on board need besides, with commas between (kept by upgrades):
                            $(extras_there)
  --python PROGRAM          the Python to use (3.10 or newer)
  --no-start                start nothing
  --force                   even where the vehicle is armed
HELP
}

say() { printf '==> %s\n' "$*"; }
warn() { printf 'install.sh: %s\n' "$*" >&2; }
fail() { warn "$@"; exit 1; }
booted() { [ -d /run/systemd/system ]; }
is_user() { getent passwd "$1" >/dev/null; }
is_group() { getent group "$1" >/dev/null; }
current() { [ ! -e "$OPT/current" ] || readlink -f "$OPT/current"; }
# Nothing of an environment is run by root: it would have root's rights over whatever it is tricked into.
version_in() { as zmav "$1/bin/python" -c 'from importlib.metadata import version; print(version("zmav"))'; }
as() { local who=$1; shift; (cd / && runuser -u "$who" -- env -u ZMAV_CREDENTIALS -u ZMAV_FLEET HOME=/ "$@"); }
setting() { [ ! -f "$ETC/vehicle.env" ] || sed -n "s/^$1=//p" "$ETC/vehicle.env" | tail -n 1; }

# Before all else: a 32-bit system may run on a 64-bit kernel, as Raspberry Pi OS does, and 'uname -m' tells the kernel's.
check_bits() {
    [ "$(getconf LONG_BIT 2>/dev/null)" != 32 ] ||
        fail "64-bit only: this system is 32-bit, for which msgspec, numpy and OpenCV have no wheels (on a Raspberry Pi, install the 64-bit system)"
}

check_machine() {
    [ "$(id -u)" = 0 ] || fail "needs root: sudo $SELF"
    [ "$(uname -s)" = Linux ] || fail "this is $(uname -s): a vehicle's computer runs Linux"
    case $(uname -m) in
        x86_64|aarch64) ;;
        *) fail "this is $(uname -m): expected x86_64 or aarch64 (on a Raspberry Pi, the 64-bit system)" ;;
    esac
    command -v systemctl >/dev/null || fail "there is no systemctl: Debian, Raspberry Pi OS and Ubuntu have systemd"
    for each in useradd runuser flock getent; do
        command -v "$each" >/dev/null || fail "there is no $each: apt-get install passwd util-linux libc-bin"
    done
    exec 9>"$LOCK"
    flock -n 9 || fail "another install.sh is at work: wait for it to end"
}

find_python() {
    local each
    for each in ${PYTHON:-python3 python3.13 python3.12 python3.11 python3.10}; do
        "$each" -c 'import sys; sys.exit(sys.version_info < (3, 10) or sys.maxsize < 2**32)' 2>/dev/null || continue
        PYTHON=$(command -v "$each")
        "$PYTHON" -c 'import ensurepip, venv' 2>/dev/null && return
        command -v apt-get >/dev/null || fail "$PYTHON lacks venv: install it with your system's packages"
        say "installing python3-venv, which $PYTHON lacks"
        DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends python3-venv >/dev/null ||
            fail "apt-get could not install python3-venv: see above; after 'apt-get update' say it again"
        "$PYTHON" -c 'import ensurepip, venv' 2>/dev/null && return
        fail "$PYTHON still lacks venv: name another with --python"
    done
    fail "zmav needs a 64-bit Python, 3.10 or newer, found none among ${PYTHON:-python3, python3.10 to python3.13}: see --python"
}

make_user() {
    local name=$1 group; shift
    if is_user "$name"; then
        getent passwd "$name" | cut -d: -f5 | grep -qx "$MARK" ||
            fail "there is a user $name who is not the service's: rename or remove that one first"
    else
        useradd --system --user-group --no-create-home --home-dir "/var/lib/$name" --shell /usr/sbin/nologin \
            --comment "$MARK" "$name"
    fi
    for group in "$@"; do
        if is_group "$group"; then usermod --append --groups "$group" "$name"; fi
    done
}

# A folder that only root writes to and only that user reads. A newer roster is kept in the service's state directory.
# What root wrote where somebody else may make links would be written wherever those point.
put_credentials() {
    local from=$1 to=$2 owner=$3 each new odd
    if [ -n "$from" ]; then
        for each in ca.pem cert.pem key.pem roster.json; do
            [ -f "$from/$each" ] || fail "$from lacks $each: give the folder that 'zmav mesh ca issue' made"
        done
    fi
    [ ! -L "$to" ] || fail "$to is a link: remove it, and say it again"
    mkdir -p "$to"
    chown "root:$owner" "$to"
    chmod 750 "$to"
    # From here on nobody else can put anything there.
    odd=$(find "$to" -mindepth 1 ! \( -type f -links 1 \) -print -quit)
    [ -z "$odd" ] || fail "$odd is no plain file of its own, and root would follow it: look at it, and remove it"
    if [ -n "$from" ]; then
        for each in ca.pem cert.pem key.pem roster.json; do
            new=$(mktemp "$to/.new-XXXXXX")
            cat "$from/$each" >"$new"
            mv -T "$new" "$to/$each"
        done
    fi
    # A key is taken only by its owner, and only where nobody else may read it: of the service, who cannot replace it.
    find "$to" -mindepth 1 -exec chown "$owner:$owner" {} + -exec chmod 400 {} +
}

set_in() { # FILE NAME VALUE
    touch "$1"
    sed -i "/^$2=/d" "$1"
    printf '%s=%s\n' "$2" "$3" >>"$1"
}

# A change of settings that comes to nothing is taken back with the environment it came with.
SAVED=""
save_settings() {
    [ -n "$1" ] || return 0
    SAVED=$(mktemp -d "$OPT/.settings-XXXXXX")
    cp -a "$ETC/." "$SAVED/"
}

take_back_settings() {
    local each
    [ -n "$SAVED" ] || return 0
    for each in vehicle.toml vehicle.env agents.env credentials agent-credentials; do
        rm -rf "${ETC:?}/$each"
        if [ -e "$SAVED/$each" ]; then cp -a "$SAVED/$each" "$ETC/$each"; fi
    done
    rm -rf "$SAVED"
    SAVED=""
}

put_settings() {
    local name
    mkdir -p "$ETC/agents.d"
    chmod 755 "$ETC" "$ETC/agents.d"
    name=${NAME:-$(setting ZMAV_NAME)}
    NAME=${name:-quad1}
    [[ $NAME =~ ^[a-z0-9_-]+$ ]] || fail "--name $NAME: use lower-case letters, digits, '_' and '-'"
    [[ ${FLEET:-demo} =~ ^[a-z0-9_-]+$ ]] || fail "--fleet $FLEET: use lower-case letters, digits, '_' and '-'"
    if [ -n "$FLEET_FILE" ]; then
        [ -f "$FLEET_FILE" ] || fail "there is no $FLEET_FILE"
        install -m 644 "$FLEET_FILE" "$ETC/vehicle.toml"
    elif [ ! -f "$ETC/vehicle.toml" ]; then
        local link=${LINK:-/dev/autopilot}
        case $link in *[\"\\\|\&]*) fail "--link $link: give it in $ETC/vehicle.toml" ;; esac
        sed -e "s|@NAME@|$NAME|g" -e "s|@FLEET@|${FLEET:-demo}|" -e "s|@LINK@|$link|" \
            "$TREE/deploy/vehicle.toml" >"$ETC/vehicle.toml"
    elif [ -n "$LINK$FLEET" ]; then
        fail "$ETC/vehicle.toml is there already: change the link and the fleet in it, or give --fleet-file"
    fi
    put_credentials "$CREDENTIALS" "$ETC/credentials" zmav
    put_credentials "$AGENT_CREDENTIALS" "$ETC/agent-credentials" zmav-agent
    [ -f "$ETC/vehicle.env" ] || echo "# Read by zmav-vehicle.service; written by deploy/install.sh." >"$ETC/vehicle.env"
    set_in "$ETC/vehicle.env" ZMAV_NAME "$NAME"
    if [ -n "$CREDENTIALS" ]; then set_in "$ETC/vehicle.env" ZMAV_CREDENTIALS "$ETC/credentials"; fi
    if [ -n "$AGENT_CREDENTIALS" ]; then set_in "$ETC/agents.env" ZMAV_CREDENTIALS "$ETC/agent-credentials"; fi
    chmod 644 "$ETC/vehicle.toml" "$ETC/vehicle.env"
}

# Sets NEW. What is not compiled here would be compiled at each start: the service cannot write there. What no start
# loads is more than half of all: pip itself, others' tests, lexers.
build() {
    local extras=$EXTRAS work each
    if [ -z "$extras" ] && [ -f "$OPT/current/extras" ]; then extras=$(cat "$OPT/current/extras"); fi
    umask 022    # the service's user reads what is made here
    mkdir -p "$OPT"
    NEW=$OPT/env-$(date -u +%Y%m%dT%H%M%S)-$$
    say "making $NEW with $("$PYTHON" -V), versions as in requirements.lock (a minute or some)"
    "$PYTHON" -I -m venv "$NEW" || fail "$PYTHON cannot make an environment: see above; or name another with --python"
    # Built by the service's user, from a copy: what a build runs is not root's, and leaves nothing behind in the tree.
    work=$(mktemp -d "$OPT/.build-XXXXXX")
    WORK=$work
    cp -r "$TREE"/{zmav,agents,mesh,ground,deploy,pyproject.toml,README.md,LICENSE,requirements.lock} "$work/"
    chown -R zmav:zmav "$work"
    # Without word splitting 'a,b' would be one extra.
    # shellcheck disable=SC2086
    { as zmav "$NEW/bin/python" "$work/deploy/needed.py" ${extras//,/ } >"$NEW/needed.txt" &&
        as zmav "$NEW/bin/python" "$work/deploy/needed.py" --only build >"$NEW/tools.txt"; } || fail "see --extras"
    for each in needed tools; do chmod 644 "$NEW/$each.txt"; done
    # Wheels that the lock has a hash of, and nothing else: they are unpacked, and run nothing. Ours comes first, so that
    # pip, which is root's, never starts in an environment where others' packages are.
    as zmav "$PYTHON" -m venv "$work/env" &&
        as zmav "$work/env/bin/python" -m pip "${PIP[@]}" --require-hashes --only-binary :all: -r "$NEW/tools.txt" &&
        as zmav "$work/env/bin/python" -m pip --disable-pip-version-check --no-input --quiet wheel --no-cache-dir \
            --no-deps --no-build-isolation --wheel-dir "$work/made" "$work" &&
        "$NEW/bin/python" -I -m pip "${PIP[@]}" --no-compile --no-deps --no-index "$work"/made/zmav-*.whl &&
        "$NEW/bin/python" -I -m pip "${PIP[@]}" --no-compile --require-hashes --only-binary :all: -r "$NEW/needed.txt" ||
        fail "pip could not install zmav: see above; it needs the network, and room in $OPT ($(df -Ph "$OPT" | awk 'END { print $4 }') are free)"
    rm -rf "$work" "$NEW/tools.txt"
    printf '%s' "$extras" >"$NEW/extras"
    mkdir -p "$NEW/share/zmav"
    cp "$TREE"/deploy/systemd/*.service "$TREE"/deploy/udev/*.rules "$NEW/share/zmav/"
    "$PYTHON" -m compileall -q -j 0 -x 'site-packages/pip/|/tests/|pygments/lexers/|pymavlink/(dialects|generator|tools)' "$NEW/lib" >/dev/null || true
    "$PYTHON" -m compileall -q "$NEW"/lib/python3*/site-packages/pymavlink/dialects/v20/{ardupilotmega,common}.py >/dev/null || true
    chmod -R go=rX "$NEW"
}

# What can be known of it before anything is stopped.
try() {
    local credentials said
    credentials=$(setting ZMAV_CREDENTIALS)
    said=$(as zmav "$NEW/bin/zmav" --version 2>&1 && as zmav "$NEW/bin/zmav" up --help 2>&1) || fail "the new environment does not run; it was not switched to:
$said"
    said=$(as zmav "$NEW/bin/zmav" mesh config --json --file "$ETC/vehicle.toml" --name "$NAME" \
        ${credentials:+--credentials "$credentials"} 2>&1 >/dev/null) ||
        fail "$ETC/vehicle.toml or the credentials are not in order; nothing was switched. Mend it, and say it again:
$said"
}

# Files of an environment that live elsewhere: they are switched with it, and back.
put_units() {
    install -m 644 "$1"/share/zmav/*.service "$UNITS/"
    if [ -d "$(dirname "$RULES")" ]; then install -m 644 "$1/share/zmav/$(basename "$RULES")" "$RULES"; fi
    ln -sfn "$1" "$OPT/.current"
    mv -T "$OPT/.current" "$OPT/current"
    ln -sfn "$OPT/current/bin/zmav" "$COMMAND"
    if booted; then
        systemctl daemon-reload
        udevadm control --reload 2>/dev/null || true
        udevadm trigger --subsystem-match=tty --action=change 2>/dev/null || true
    fi
}

is_armed() {
    [ -n "$1" ] && booted && systemctl is-active --quiet "$VEHICLE" &&
        as zmav "$1/bin/zmav" ls --fleet '*' --json --wait 2 2>/dev/null | grep "\"name\": \"$(setting ZMAV_NAME)\"" | grep -q '"armed": true'
}

# It has said that it is ready, keeps to one process for longer than its watchdog, and its state is heard.
is_healthy() {
    local pid
    systemctl reset-failed "$VEHICLE" 2>/dev/null || true
    systemctl restart "$VEHICLE" || return 1
    pid=$(systemctl show --property=MainPID --value "$VEHICLE")
    for _ in $(seq "$SETTLE"); do
        sleep 1
        [ "$(systemctl show --property=MainPID,ActiveState --value "$VEHICLE" | sort | paste -sd' ')" = "$pid active" ] ||
            return 1
    done
    as zmav "$1/bin/zmav" ls --fleet '*' --json --wait 3 2>&1 | grep -q "\"name\": \"$NAME\"" ||
        { warn "$VEHICLE runs, but 'zmav ls' does not hear $NAME"; return 1; }
}

switch() {
    local old=$1 was=inactive first=""
    if booted && systemctl is-active --quiet "$VEHICLE"; then was=active; fi
    # The build took a while.
    if [ -z "$FORCE" ] && is_armed "$old"; then fail "$(setting ZMAV_NAME) was armed meanwhile: land it first (or say --force)"; fi
    trap '' HUP INT TERM    # from here to the end: a terminal that is lost leaves nothing half switched
    trap 'rm -rf "$SAVED"' EXIT
    [ -f "$UNITS/$ROS2" ] || first=yes
    put_units "$NEW"
    if [ -z "$old" ]; then systemctl enable --quiet "$VEHICLE"; fi
    if [ -n "$first" ]; then systemctl enable --quiet "$ROS2"; fi
    if ! booted || [ -n "$NO_START" ]; then
        if [ -n "$NO_START" ]; then say "not started, as you said"; else say "not started: systemd does not run here"; fi
        if [ -n "$old" ]; then say "the environment before is kept, as nobody can say whether the new one is healthy: $old"; fi
        return
    fi
    say "starting $VEHICLE and watching it for $SETTLE s"
    if is_healthy "$NEW"; then
        # Of an earlier upgrade that was cut short, too.
        find "$OPT" -mindepth 1 -maxdepth 1 \( -name 'env-*' -o -name '.build-*' -o -name '.settings-*' \) ! -path "$NEW" -exec rm -rf {} +
        if [ -n "$old" ] && [ "$was" = inactive ]; then
            systemctl stop "$VEHICLE"
            say "stopped again, as it was"
        elif systemctl is-enabled --quiet "$ROS2"; then
            systemctl restart --no-block "$ROS2"
        fi
        systemctl try-restart 'zmav-agent@*.service'
        return
    fi
    journalctl --no-pager --quiet --unit "$VEHICLE" --lines 20 >&2 || true
    if [ -z "$old" ]; then
        fail "$VEHICLE is not healthy: what it said is above. Mend $ETC/vehicle.toml, then: systemctl restart $VEHICLE"
    fi
    warn "$VEHICLE is not healthy, what it said is above: going back to $old"
    take_back_settings
    if [ -n "$first" ]; then systemctl disable --quiet "$ROS2"; rm -f "$UNITS/$ROS2"; fi    # that one knows none
    put_units "$old"
    if is_healthy "$old"; then
        rm -rf "$NEW"
        if [ "$was" = inactive ]; then systemctl stop "$VEHICLE"; fi
        fail "the upgrade was taken back; the version before ($(version_in "$old")) runs as it did"
    fi
    fail "the version before is back, and is not healthy either: 'journalctl -u $VEHICLE' says why; $NEW is kept to be looked at"
}

do_install() {
    check_bits
    check_machine
    find_python
    local old
    old=$(current)
    if [ -z "$old" ] && [ -e "$COMMAND" ]; then fail "$COMMAND is somebody else's: move it away first"; fi
    make_user zmav dialout
    make_user zmav-agent video render
    as zmav "$PYTHON" -c '' 2>/dev/null ||
        fail "the service's user cannot run $PYTHON (is it in somebody's home?): name another with --python"
    if [ -z "$FORCE" ] && is_armed "$old"; then fail "$(setting ZMAV_NAME) is armed: land it first (or say --force)"; fi
    trap 'rm -rf "$NEW" "$WORK"; take_back_settings' EXIT
    save_settings "$old"
    put_settings
    build
    try
    switch "$old"
    say "zmav $(version_in "$NEW") is installed for ${NAME}: 'zmav ls' shows it, 'zmav doctor' what is left to do"
    if ! booted || [ -n "$NO_START" ]; then say "start it with: systemctl start $VEHICLE"; fi
}

do_uninstall() {
    check_machine
    local each
    if [ -z "$FORCE" ] && is_armed "$(current)"; then
        fail "$(setting ZMAV_NAME) is armed: land it first (or say --force)"
    fi
    for each in "$VEHICLE" "$ROS2" $(find "$ETC/agents.d" -name '*.toml' -printf 'zmav-agent@%f\n' 2>/dev/null | sed 's/\.toml$/.service/'); do
        systemctl disable --quiet "$each" 2>/dev/null || true
        if booted; then systemctl stop "$each" 2>/dev/null || true; systemctl reset-failed "$each" 2>/dev/null || true; fi
    done
    rm -f "$UNITS/$VEHICLE" "$UNITS/$ROS2" "$UNITS/zmav-agent@.service" "$RULES"
    if [ -L "$COMMAND" ]; then case $(readlink "$COMMAND") in "$OPT"/*) rm "$COMMAND" ;; esac; fi
    rm -rf "$OPT"
    if booted; then systemctl daemon-reload; udevadm control --reload 2>/dev/null || true; fi
    for each in $STATE; do
        # Logs that were fetched from the autopilot may be the only copy.
        if [ -n "$PURGE" ] || [ -z "$(find "$each" -type f -print -quit 2>/dev/null)" ]; then rm -rf "$each"; continue; fi
        chown -R root:root "$each"
        say "kept: $each (--uninstall --purge removes it)"
    done
    if [ -n "$PURGE" ]; then
        rm -rf "$ETC"
    elif [ -d "$ETC" ]; then
        chown -R root:root "$ETC" # a number without a user may become somebody else's
        say "kept: $ETC, with its keys (--uninstall --purge removes it)"
    fi
    for each in zmav zmav-agent; do
        if is_user "$each" && getent passwd "$each" | cut -d: -f5 | grep -qx "$MARK"; then userdel "$each"; fi
    done
    rm -f "$LOCK"
    say "zmav is removed; the journal keeps what it said, and packages that it had installed (python3-venv) stay"
}

WRONG=0
look() { # WORDS WHAT-TO-DO COMMAND...
    local words=$1 advice=$2; shift 2
    if "$@" >/dev/null 2>&1; then printf 'ok    %s\n' "$words"; else printf 'WRONG %s: %s\n' "$words" "$advice"; WRONG=1; fi
}

do_check() {
    [ "$(id -u)" = 0 ] || fail "needs root: sudo $SELF --check"
    local env name credentials unit
    env=$(current); name=$(setting ZMAV_NAME); credentials=$(setting ZMAV_CREDENTIALS)
    [ -n "$env" ] || fail "zmav is not installed here: sudo $SELF"
    look "$env runs" "install again" as zmav "$env/bin/zmav" --version
    look "user zmav" "install again" is_user zmav
    look "user zmav-agent" "install again" is_user zmav-agent
    look "zmav may use serial ports" "usermod --append --groups dialout zmav" eval 'id -nG zmav | grep -qw dialout'
    look "$ETC/vehicle.toml has $name" "zmav mesh config --file $ETC/vehicle.toml --name $name says what is wrong" \
        as zmav "$env/bin/zmav" mesh config --file "$ETC/vehicle.toml" --name "$name" ${credentials:+--credentials "$credentials"}
    look "only zmav reads $ETC/credentials, and only root writes there" "install again" \
        eval "[ \"\$(stat -c %U:%G:%a $ETC/credentials)\" = root:zmav:750 ]"
    if [ -f "$ETC/credentials/key.pem" ]; then
        look "the credentials are used" "echo ZMAV_CREDENTIALS=$ETC/credentials >>$ETC/vehicle.env" [ -n "$credentials" ]
    fi
    for unit in "$VEHICLE" "$ROS2"; do
        look "$unit as in $env" "install again" cmp -s "$UNITS/$unit" "$env/share/zmav/$unit"
    done
    if booted; then
        look "$VEHICLE begins with the computer" "systemctl enable $VEHICLE" systemctl is-enabled --quiet "$VEHICLE"
        look "$VEHICLE runs" "journalctl -u $VEHICLE says why not" systemctl is-active --quiet "$VEHICLE"
        look "$name is heard" "journalctl -u $VEHICLE" eval "as zmav $env/bin/zmav ls --fleet '*' --json --wait 3 | grep -q '\"name\": \"$name\"'"
    fi
    exit "$WRONG"
}

PIP=(--disable-pip-version-check --no-input --quiet install --no-cache-dir)
DO=do_install NEW="" WORK="" NAME="" FLEET="" LINK="" FLEET_FILE="" CREDENTIALS="" AGENT_CREDENTIALS="" EXTRAS="" NO_START="" FORCE="" PURGE=""
PYTHON=${PYTHON:-}
while [ $# -gt 0 ]; do
    case $1 in
        --check) DO=do_check ;;
        --uninstall) DO=do_uninstall ;;
        --purge) PURGE=yes ;;
        --no-start) NO_START=yes ;;
        --force) FORCE=yes ;;
        -h|--help) usage; exit 0 ;;
        --name|--fleet|--link|--fleet-file|--credentials|--agent-credentials|--extras|--python)
            [ $# -ge 2 ] || fail "$1 wants a value: see --help"
            case $1 in
                --name) NAME=$2 ;;
                --fleet) FLEET=$2 ;;
                --link) LINK=$2 ;;
                --fleet-file) FLEET_FILE=$2 ;;
                --credentials) CREDENTIALS=$2 ;;
                --agent-credentials) AGENT_CREDENTIALS=$2 ;;
                --extras) EXTRAS=$2 ;;
                --python) PYTHON=$2 ;;
            esac
            shift ;;
        *) warn "there is no option $1"; usage >&2; exit 2 ;;
    esac
    shift
done
[ -z "$PURGE" ] || [ "$DO" = do_uninstall ] || fail "--purge goes with --uninstall"
"$DO"
