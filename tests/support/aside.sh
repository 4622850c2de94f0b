#!/bin/sh
# Runs a command in the processor time that all others leave over, and ends with its exit code.
#
# SCHED_IDLE alone counts only within a session where the kernel makes a group of each (/proc/PID/autogroup), and the browsers
# and demos of the tests have sessions of their own. So the command has one too, of which the whole group comes last. Ctrl-C
# does not reach another session: it is handed on.
setsid sh -c '(echo 19 >/proc/$$/autogroup) 2>/dev/null; exec chrt --idle 0 "$@"' sh "$@" &
command=$!
trap 'kill -TERM -- "-$command" 2>/dev/null; wait "$command"; exit 130' INT TERM HUP
wait "$command"
