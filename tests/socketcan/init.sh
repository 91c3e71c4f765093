#!/bin/sh
# The first process inside user-mode Linux, started by with_vcan0.py: makes vcan0, runs a command, halts.
# The machine's own files are there, read-only; what is written goes to the scratch folder.

export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin SCRATCH=/run/scratch TMPDIR=/run/tmp HOME=/run/tmp

mount -t proc none /proc
mount -t sysfs none /sys
mount -t tmpfs none /run
mkdir -p "$SCRATCH" "$TMPDIR" /dev/shm
mount -t tmpfs none /dev/shm
for word in $(cat /proc/cmdline); do
    case "$word" in scratch=*) mount -t hostfs none "$SCRATCH" -o "${word#scratch=}" ;; esac
done

{
    modules=/usr/lib/uml/modules/$(uname -r)/kernel
    for module in net/can/can net/can/can-raw drivers/net/can/dev/can-dev drivers/net/can/vcan; do
        test ! -e "$modules/$module.ko" || insmod "$modules/$module.ko"
    done
    ip link set lo up
    ip link add dev vcan0 type vcan
    ip link set vcan0 mtu 72 up
    sh "$SCRATCH/command"
    echo $? > "$SCRATCH/code"
} > "$SCRATCH/output" 2>&1

exec halt -f
