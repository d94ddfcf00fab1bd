# First process of the guest, run by busybox. $1: the folder of the run, with
#   settings   busybox=FILE modules='FILE [PARAMETER]', one a line, buses=NUMBER
#   command    a script that becomes the command
# Leaves there `status`, the command's exit status. What it says itself goes to the console.
# ttyS0, ttyS1: the command's output and errors. ttyS2: lines INT, TERM, HUP or KILL from outside.
run=$1
. "$run/settings"

b() { "$busybox" "$@"; }

off() {
    b sync
    b poweroff -f
}

fail() {
    echo "init: $*"
    off
}

file_systems() {
    b mount -t proc proc /proc || fail "no /proc"
    b mount -t sysfs sysfs /sys
    b mkdir -p /dev/shm /dev/pts
    b mount -t tmpfs -o mode=1777 shm /dev/shm
    b mount -t devpts devpts /dev/pts
    b mount -t tmpfs -o mode=755 run /run
    [ -e /dev/fd ] || b ln -s /proc/self/fd /dev/fd
    for name in stdin:0 stdout:1 stderr:2; do
        [ -e "/dev/${name%:*}" ] || b ln -s "/proc/self/fd/${name#*:}" "/dev/${name%:*}"
    done
}

network() {
    while read -r file parameters; do
        # shellcheck disable=SC2086
        [ -z "$file" ] || b insmod "$file" $parameters || fail "cannot load $file"
    done <<END
$modules
END
    b ip link set lo up
    i=0
    while [ "$i" -lt "$buses" ]; do
        b ip link add dev "vcan$i" type vcan && b ip link set "vcan$i" mtu 72 up ||
            fail "cannot make vcan$i"
        i=$((i + 1))
    done
}

# The host takes the guest's only CPU away as it likes, and what it takes counts as the real-time tasks'
# own: the guest would put them to sleep for 50 ms. One that runs wild is ended by the time-out.
# It has no threads for writing files either: nothing else runs meanwhile. Until memory is short,
# they are written at the end.
real_time() {
    echo -1 >/proc/sys/kernel/sched_rt_runtime_us
    echo 0 >/proc/sys/vm/dirty_writeback_centisecs
    echo 60 >/proc/sys/vm/dirty_background_ratio
    echo 80 >/proc/sys/vm/dirty_ratio
}

# Signals from outside go to the command's process group. The line breaks when the launcher dies.
listen() {
    while read -r signal; do
        signal "$signal"
    done
    signal TERM
    b sleep 3
    signal KILL
}

signal() { # name
    until [ -s /dev/vcan-session ]; do
        b usleep 20000
    done
    read -r session </dev/vcan-session
    kill "-$1" "-$session"
}

# What the command left running would hold its output open.
end_all_but() { # process ids
    for folder in /proc/[0-9]*; do
        case " 1 $* " in
        *" ${folder#/proc/} "*) ;;
        *) kill -KILL "${folder#/proc/}" 2>/dev/null ;;
        esac
    done
}

file_systems
network
real_time
exec 7>/dev/ttyS0 8>/dev/ttyS1
b stty raw -echo -opost clocal <&7
b stty raw -echo -opost clocal <&8
b stty -echo clocal </dev/ttyS2
b mkfifo /dev/vcan-out /dev/vcan-err || fail "no pipes"
# By their file, not by b(): the process ids are to be those of the programs.
"$busybox" cat /dev/vcan-out >&7 &
out=$!
"$busybox" cat /dev/vcan-err >&8 &
err=$!
listen </dev/ttyS2 7>&- 8>&- &
# Not in the background, where a shell has its children ignore SIGINT; in a subshell, so that what
# this shell says of its end is not written among the errors of the command.
# shellcheck disable=SC2016
(exec "$busybox" setsid "$busybox" sh -c 'echo $$ >/dev/vcan-session; . "$0"' "$run/command" \
    </dev/null >/dev/vcan-out 2>/dev/vcan-err 7>&- 8>&-)
status=$?
end_all_but "$out" "$err" 2>/dev/null
wait "$out" "$err"
b stty raw <&7 # returns when all has been written
b stty raw <&8
echo "$status" >"$run/status"
off
