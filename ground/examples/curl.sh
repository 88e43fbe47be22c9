#!/usr/bin/env bash
# The fleet with curl: who is there, an order that is asked again until it has ended, setpoints, a refusal.
#
#   zmav sim --up                     # in another terminal, and 'zmav http' in a third
#   ground/examples/curl.sh           # or with a vehicle and the gateway: quad1 http://127.0.0.1:8088
set -euo pipefail
vehicle=${1:-quad1} gateway=${2:-http://127.0.0.1:8088}

ask() { curl --silent --show-error --max-time 10 "$@"; }

# An answer may be lost on the way: the same id again is answered, and nothing is done twice.
order() { # VERB [MORE-ARGUMENTS]
    local id="curl-$$-$RANDOM" answer
    while :; do
        answer=$(ask --header 'Content-Type: application/json' --data "{\"id\": \"$id\", \"wait\": 1${2:+, $2}}" \
            "$gateway/do/$vehicle/$1") || { echo "$1: no answer, asked again"; sleep 1; continue; }
        case $answer in
            *running*) echo "$1: not done yet" ;;
            *error*) echo "$1 refused: $answer"; return 1 ;;
            *) echo "$1: $answer"; return 0 ;;
        esac
    done
}

echo "who is there:"
ask "$gateway/vehicles"
order arm
order takeoff '"alt_rel": 8'
order goto '"pos": [0, 0, -90000]' || echo "it flies on: what is refused changes nothing"
# The gateway takes the lease for its caller, and gives it back when no more points come.
for ((i = 1; i <= 40; i++)); do
    ask "$gateway/setpoint/$vehicle?n=6&e=2&d=-8&as=curl" > /dev/null
    sleep 0.1
done
ask "$gateway/setpoint/$vehicle?n=6&e=2&d=-8&as=curl&envelope=1"
ask "$gateway/release/$vehicle?as=curl"
order land
