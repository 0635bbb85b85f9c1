#!/usr/bin/env bash
# Runs a command with a Slurm of one node, this machine, started for it and stopped behind it. Needs root and Debian's slurmctld, slurmd, munge, slurm-client.
#
#   studies/slurm_one_node.sh snakemake -s studies/Snakefile --executor slurm --jobs 4 --config …
set -euo pipefail

state="$(mktemp -d)"
host="$(hostname -s)"
# All processes started here, by their own numbers.
started=()
linked=no
stop() {
    for process in "${started[@]}"; do kill "$process" 2>/dev/null || true; done
    for process in "${started[@]}"; do wait "$process" 2>/dev/null || true; done
    [ "$linked" = no ] || rm -f /etc/slurm/slurm.conf
    rm -rf "$state"
}
trap stop EXIT

chmod 755 "$state"
mkdir -m 700 "$state/munge"
mkdir -p "$state/ctld" "$state/d"
head -c 64 /dev/urandom >"$state/munge/key"
chmod 400 "$state/munge/key"
munge_socket="$state/munge.socket"
munged --foreground --force --key-file "$state/munge/key" --socket "$munge_socket" --pid-file "$state/munge/pid" \
    --seed-file "$state/munge/seed" --log-file "$state/munge/log" >"$state/munged.log" 2>&1 &
started+=($!)

# Steps inside of a job look for the configuration in its usual place alone.
if [ -e /etc/slurm/slurm.conf ]; then
    echo "this machine has a Slurm of its own (/etc/slurm/slurm.conf): use that one" >&2
    exit 1
fi
mkdir -p /etc/slurm
ln -s "$state/slurm.conf" /etc/slurm/slurm.conf
linked=yes
cat >"$state/slurm.conf" <<CONF
ClusterName=one
SlurmctldHost=$host(127.0.0.1)
SlurmUser=root
AuthType=auth/munge
AuthInfo=socket=$munge_socket
SlurmctldPort=16817
SlurmdPort=16818
StateSaveLocation=$state/ctld
SlurmdSpoolDir=$state/d
SlurmctldPidFile=$state/ctld.pid
SlurmdPidFile=$state/d.pid
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
JobAcctGatherType=jobacct_gather/none
ReturnToService=2
MpiDefault=none
NodeName=$host NodeAddr=127.0.0.1 CPUs=$(nproc) RealMemory=$(awk '/MemTotal/ {print int($2 / 1100)}' /proc/meminfo) State=UNKNOWN
PartitionName=one Nodes=$host Default=YES MaxTime=INFINITE State=UP
CONF

until [ -S "$munge_socket" ]; do sleep 0.1; done
slurmctld -D >"$state/ctld.log" 2>&1 &
started+=($!)
slurmd -D >"$state/d.log" 2>&1 &
started+=($!)
for _ in $(seq 100); do
    [ "$(sinfo --noheader --format=%T 2>/dev/null)" = idle ] && break
    sleep 0.2
done
if [ "$(sinfo --noheader --format=%T 2>/dev/null)" != idle ]; then
    tail -n 20 "$state"/*.log >&2
    exit 1
fi
"$@"
