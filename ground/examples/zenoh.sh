#!/usr/bin/env bash
# The fleet with Zenoh's own command line (pip install zenoh-cli): orders, a lease, a stream of setpoints, a refusal.
#
#   zmav sim --up                     # in another terminal
#   ground/examples/zenoh.sh          # or with a vehicle, its fleet and a router: quad1 demo tcp/127.0.0.1:7447
set -euo pipefail
vehicle=${1:-quad1} fleet=${2:-demo} router=${3:-tcp/127.0.0.1:7447}
base=zmav/$fleet/$vehicle

ask() { zenoh --mode client --connect "$router" get --decoder json --selector "$base/$1" ${2:+--value "$2"} 2>&1; }

# An answer may be lost on the way: the same id again is answered, and nothing is done twice.
order() { # VERB [MORE-ARGUMENTS]
    local id="shell-$$-$RANDOM" answer
    while :; do
        answer=$(ask "do/$1" "{\"id\": \"$id\", \"wait\": 1${2:+, $2}}")
        case $answer in
            '') echo "$1: no answer, asked again" ;;
            *'"running"'*) echo "$1: not done yet" ;;
            *'"done"'*) echo "$1: $answer"; return 0 ;;
            *) echo "$1 refused: $answer"; return 1 ;;
        esac
    done
}

echo "who is there:"
zenoh --mode client --connect "$router" liveliness get --key "zmav/$fleet/*/alive/vehicle/**"
order arm
order takeoff '"alt_rel": 8'
order goto '"pos": [0, 0, -90000]' || echo "it flies on: what is refused changes nothing"

# Each point renews the lease, here for ten seconds; after half a second without one the vehicle holds.
granted=$(order lease '"holder": "shell", "ttl": 10')
lease=$(sed -n 's/.*"lease": "\([^"]*\)".*/\1/p' <<< "$granted")
for ((i = 1; i <= 40; i++)); do
    late=$(($(date +%s%N) + 500000000)) # UTC, after which it is not to be flown
    printf '{"lease": "%s", "seq": %d, "deadline": %d.%09d, "pos": [6, 2, -8]}\n' \
        "$lease" "$i" $((late / 1000000000)) $((late % 1000000000))
    sleep 0.1
done | zenoh --mode client --connect "$router" put --key "$base/setpoint/shell" --line '{value}'
ask state | sed -n 's/.*"setpoints": \({[^}]*}\).*/setpoints: \1/p'
order release "\"lease\": \"$lease\""
order land
