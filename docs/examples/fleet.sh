#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# A first fleet with keys, on this machine alone: two virtual robots are let in, driven and stopped; an intruder and a
# viewer are refused; the operator is locked out while a robot drives. Every command is printed before it runs.
#
#     docs/examples/fleet.sh [DIR]           the whole story, in about a minute
#     docs/examples/fleet.sh --hold [DIR]    the fleet alone, until Ctrl-C, for a client of your own
#
# `cruiser` is on the PATH. Each machine and person has a directory below DIR (demo-fleet), as if on a machine of their
# own; only requests and bundles lie in DIR itself and travel. Keys have no passphrase: they are good for this alone.
set -euo pipefail

hold=
if [ "${1:-}" = --hold ]; then hold=yes; shift; fi
port=${PORT:-7450}
router=tls/127.0.0.1:$port
# Settings of another robot, or of another fleet, are not meant for this one.
unset "${!CRUISER_@}"
mkdir "${1:-demo-fleet}"
cd "${1:-demo-fleet}"
declare -A pid
trap 'trap - EXIT; end || true' EXIT
trap 'exit 3' INT TERM HUP

run() { # WORDS...
    printf '  $ cruiser'
    printf ' %q' "$@"
    echo
    cruiser "$@"
}

must_end_with() { # CODE WORDS...
    local wanted=$1 code=0
    shift
    run "$@" 2>&1 || code=$?
    if [ "$code" != "$wanted" ]; then
        echo "NOT AS IT SHOULD BE: exit code $code, not $wanted"
        exit 1
    fi
}

end() { # the gateways first: they bring their robots to rest
    for name in cruiser-1 cruiser-2; do
        if [ -n "${pid[$name]:-}" ]; then kill "${pid[$name]}" && wait "${pid[$name]}"; fi
    done
    kill $(jobs -p)
    wait
} 2>/dev/null

begin() { # NAME WORDS... until the script ends; its output goes to NAME.log
    local name=$1
    shift
    printf '  $ cruiser %s &\n' "$*"
    cruiser "$@" >"$name.log" 2>&1 &
    pid[$name]=$!
}

start() { # NAME WORDS... and wait for its first output
    begin "$@"
    wait_until test -s "$1.log"
}

wait_until() { # COMMAND...
    for ((tries = 0; tries < 100; tries++)); do
        if "$@" >/dev/null 2>&1; then return; fi
        sleep 0.2
    done
    tail -n 3 ./*.log
    echo "NOT AS IT SHOULD BE: in vain waited for: $*"
    exit 1
}

let_in() { # ROLE NAME DIRECTORY FLAGS_OF_SIGN...
    local role=$1 name=$2 directory=$3
    shift 3
    run provision "$role" "$name" --directory "$directory"
    run provision sign "$role-$name.request" --directory authority "$@"
    run provision install "$role-$name.bundle" --directory "$directory" --fingerprint "$fingerprint"
}

shows() { # PATTERN: the viewer's list has a line like it
    cruiser list --config vic/viewer.toml | grep -qE "$1"
}

echo "the authority, and its standby"
run provision standby --directory standby --no-passphrase
run provision authority --directory authority --standby standby/standby.pub --router "$router" --no-passphrase | tee authority.log
fingerprint=$(sed -nE 's/.*authority ([0-9a-f-]{39}).*/\1/p' authority.log | head -n 1)

echo "who is let in: keys stay where they were made"
let_in router 127.0.0.1 router
let_in recorder archive recorder
let_in operator ann ann --speed-limit 0.5
let_in viewer vic vic
for robot in cruiser-1 cruiser-2; do let_in robot $robot $robot; done

echo "the machines run"
start router router --directory router
start recorder record --config recorder/recorder.toml -o recorder/log
for robot in cruiser-1 cruiser-2; do
    start "chassis-$robot" sim --listen 127.0.0.1:0
    channel=$(grep -oE '127\.0\.0\.1:[0-9]+' "chassis-$robot.log")
    cat >>$robot/robot.toml <<END

[can]
interface = "socketcand"
channel = "$channel"
[gateway]
state_dir = "$PWD/$robot/state"
END
    start $robot gateway --config $robot/robot.toml
done
for robot in cruiser-1 cruiser-2; do wait_until shows "^$robot +ready"; done

if [ -n "$hold" ]; then
    echo "the fleet runs until Ctrl-C; the router is at $router. In another terminal:"
    echo "  cruiser drive cruiser-1 --config $PWD/ann/operator.toml     (0.5 m/s at most)"
    echo "  cruiser watch cruiser-1 --config $PWD/vic/viewer.toml"
    wait
fi

echo "an intruder without a certificate, and a viewer who may not drive: nobody answers them"
must_end_with 0 list --config vic/viewer.toml
must_end_with 4 list --connect "tcp/127.0.0.1:$port" --timeout 1
must_end_with 4 drive cruiser-2 --zenoh-config vic/viewer.json5 --operator vic --speed 0.3 --seconds 1

echo "the viewer may stop, the operator resets"
must_end_with 0 stop cruiser-2 --config vic/viewer.toml --operator vic
must_end_with 0 reset cruiser-2 --config ann/operator.toml --of "vic (unproven)"

echo "the operator's grant is revoked while the robot drives: it stops, and the operator is locked out"
key=$(sed -nE 's/.*"name":"ann","key":"([0-9a-f]+)".*/\1/p' authority/issued.jsonl)
must_end_with 0 provision revoke --public-key "$key" --directory authority -o revocations.statement
begin drive drive cruiser-1 --config ann/operator.toml --speed 2 --seconds 600 --deadman 1
wait_until shows "^cruiser-1 +driving .* driver ann"
must_end_with 0 provision show revocations.statement --all --directory vic
if wait "${pid[drive]}" || ! grep grant_revoked drive.log; then
    echo "NOT AS IT SHOULD BE: the drive was not ended by the revocation:"
    cat drive.log
    exit 1
fi
must_end_with 5 drive cruiser-1 --config ann/operator.toml --speed 0.3 --seconds 1

echo "who commanded, by the log and the signatures in it"
end || true
must_end_with 0 review verify recorder/log --authority authority/authority.json
echo "all of it as it should be; files, keys and the log: $PWD"
