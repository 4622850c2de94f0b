#!/bin/sh
# Runs a command in the processor time that all others leave over, and ends with its exit code.
#
# Where the kernel makes a group of each session (/proc/PID/autogroup), SCHED_IDLE counts within that session alone,
# and the browsers and demos of the tests have sessions of their own. So the command has one too, which comes last as
# a whole. A terminal's Ctrl-C does not reach another session, and is handed on.
setsid sh -c '(echo 19 >/proc/$$/autogroup) 2>/dev/null; exec chrt --idle 0 "$@"' sh "$@" &
command=$!
trap 'kill -TERM "-$command" 2>/dev/null; wait "$command"; exit 130' INT TERM HUP
wait "$command"
