#!/usr/bin/env bash
# preheat.sbatch as users run it, on a Slurm of its own: munged, slurmctld and slurmd of Debian's
# packages in a temporary folder, two nodes on loopback, gone when it ends. Images are compared with
# that of `--local`.
#
#   docker/slurm_test.sh [BIN]   # folder of both programs (build/release/bin)
#
# Ends with one line "N passed, N failed"; 1 if any failed, 77 and the reason if Slurm is not here
# (apt-get install slurmd slurmctld slurm-client munge).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
bin=$(realpath -m "${1:-build/release/bin}")

source docker/checks.sh
for tool in munged slurmctld slurmd sbatch srun scontrol; do
  command -v "$tool" >/dev/null || PATH=$PATH:/usr/sbin command -v "$tool" >/dev/null ||
    skip "$tool is not installed"
done
PATH=$PATH:/usr/sbin
[[ -x $bin/preheat && -x $bin/preheat-worker ]] || skip "no programs in $bin"

scratch=$(mktemp -d)
chmod 755 "$scratch"
daemons=()
clean_up() {
  # Jobs outlive the daemons that started them, so they go first.
  scancel --user "$(id -un)" >/dev/null 2>&1 && eventually no_job_left
  local at
  for ((at = ${#daemons[@]} - 1; at >= 0; --at)); do
    kill "${daemons[at]}" 2>/dev/null && wait "${daemons[at]}" 2>/dev/null
  done
  rm -rf "$scratch"
}
no_job_left() { [[ -z $(squeue -h 2>/dev/null) ]]; }
trap clean_up EXIT
trap 'exit 1' INT TERM
# daemon NAME COMMAND...
daemon() {
  local name=$1
  shift
  "$@" >"$scratch/$name.log" 2>&1 </dev/null &
  daemons+=($!)
}

say "Slurm"
host=$(hostname -s)
user=$(id -un)
export SLURM_CONF=$scratch/slurm.conf
mkdir -m 711 "$scratch/munge"
mkdir -m 700 "$scratch/state" "$scratch/spool" "$scratch/work"
(umask 077 && head -c 128 /dev/urandom >"$scratch/munge/key")
# Ports below those that the system hands out by itself; a second run at once takes others.
port=$((20000 + $$ % 1000 * 8))
cat >"$SLURM_CONF" <<CONF
ClusterName=preheat
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=$port
SlurmUser=$user
SlurmdUser=$user
AuthType=auth/munge
AuthInfo=socket=$scratch/munge/socket
StateSaveLocation=$scratch/state
SlurmdSpoolDir=$scratch/spool/%n
SlurmctldPidFile=$scratch/slurmctld.pid
SlurmdPidFile=$scratch/slurmd.%n.pid
MpiDefault=none
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
ReturnToService=2
KillWait=15
NodeName=node1 NodeHostname=$host NodeAddr=127.0.0.1 Port=$((port + 1)) CPUs=$(nproc)
NodeName=node2 NodeHostname=$host NodeAddr=127.0.0.1 Port=$((port + 2)) CPUs=$(nproc)
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE
CONF
daemon munged munged --foreground --force --num-threads=2 --key-file="$scratch/munge/key" \
  --socket="$scratch/munge/socket" --pid-file="$scratch/munge/pid" \
  --log-file="$scratch/munge/log" --seed-file="$scratch/munge/seed"
eventually test -S "$scratch/munge/socket"
daemon slurmctld slurmctld -D -c
for node in node1 node2; do daemon "$node" slurmd -D -N "$node"; done
both_idle() { [[ $(sinfo -h -t idle -o %D 2>/dev/null) == 2 ]]; }
eventually both_idle || {
  tail -n 5 "$scratch/munged.log" "$scratch/slurmctld.log" "$scratch/node1.log"
  exit 1
}
sinfo --version

export PREHEAT_BIN=$bin PREHEAT_SCENE=demo:50000 XDG_CACHE_HOME=$scratch/stores
quick='--size 160x108 --spp 4 --bounces 8 --wait-workers 2'
# Small tiles, soon done, and more of them than anything here waits for: it ends by a signal.
endless='--size 4096x4096 --spp 64 --tile-size 8 --wait-workers 2'

# submit ARGS: queues a render with these arguments and sets `job`.
submit() {
  job=$(cd "$scratch/work" &&
    PREHEAT_ARGS=$1 sbatch --parsable --cpus-per-task=1 "$preheat/docker/preheat.sbatch")
}
show() { scontrol show job "$job" | tr ' ' '\n' | sed -n "s/^$1=//p"; }
ended() { [[ $(show JobState) == @(COMPLETED|FAILED|CANCELLED|TIMEOUT|NODE_FAIL) ]]; }
log() { cat "$scratch/work/preheat-$job.log" 2>/dev/null || true; }
preheat=$PWD
out=$scratch/work/out
sha_of() { sed -n 's/.*"pixels_sha256": "\([0-9a-f]*\)".*/\1/p' "$1"; }
private_folder() { find "$scratch/work" -maxdepth 1 -name ".preheat-$job.*"; }
# Tiles are done: there is a master, and workers that it let in. Asked as its user would.
renders() {
  local folder
  folder=$(private_folder)
  [[ -s $folder/endpoint ]] &&
    "$bin/preheat" status --connect "$(<"$folder/endpoint")" --keys "$folder/keys" 2>/dev/null |
    awk '$1 == "tiles" && $2 > 0 {found = 1} END {exit !found}'
}
# By their beginning, for srun names them, too.
workers() { pgrep -f "^$bin/preheat-worker --connect tcp://$host:"; }
no_worker_left() { ! workers >/dev/null; }

say "reference"
# shellcheck disable=SC2086  # several words
"$bin/preheat" render "$PREHEAT_SCENE" --local -o "$scratch/local.exr" \
  --report "$scratch/local.json" ${quick%--wait*} 2>/dev/null
expected=$(sha_of "$scratch/local.json")
printf 'sha256 %s\n' "$expected"

say "a job on two nodes"
submit "$quick"
eventually ended
log
check "it is done" equal "$(show JobState) $(show ExitCode)" "COMPLETED 0:0"
check "its image is that of --local" equal "$(sha_of "$out/report.json")" "$expected"
check "both workers took part" equal "$(grep -c '"tiles": [1-9]' "$out/report.json")" 2
check "connections were encrypted" contains "$(<"$out/report.json")" '"security": "curve"'
check "image and report are there, and nothing else" equal "$(cd "$out" && echo *)" \
  "image.exr report.json"
check "its keys are gone" equal "$(private_folder)" ""

say "signals"
rm -rf "$out"
submit "$endless"
check "it renders" eventually renders
folder=$(private_folder)
check "nobody else reads its keys" equal \
  "$(stat -c %a "$folder" "$folder/keys" "$folder"/keys/*/*.key | sort -u | tr '\n' ' ')" "600 700 "
# What --signal sends before the time limit.
scancel --batch --signal=USR1 "$job"
eventually ended
log
check "before the time limit the master ends in order" equal "$(show ExitCode)" "143:0"
check "there is no half image" equal "$(cd "$out" && echo *)" "*"
check "its keys are gone then, too" equal "$(private_folder)" ""
check "no worker is left" eventually no_worker_left

submit "$endless"
check "it renders" eventually renders
scancel "$job"
eventually ended
check "a cancelled job ends" equal "$(show JobState)" CANCELLED
check "there is no half image" equal "$(cd "$out" && echo *)" "*"
check "its keys are gone as well" eventually test -z "$(private_folder)"
check "no worker is left" eventually no_worker_left

say "a worker lost"
submit "${quick/--spp 4/--spp 64} --tile-size 8"
check "it renders" eventually renders
kill -KILL "$(workers | head -n 1)"
eventually ended
log
check "the render goes on without it" equal "$(show JobState) $(show ExitCode)" "COMPLETED 0:0"

say "misuse"
PREHEAT_SCENE=missing.glb submit "$quick"
eventually ended
check "a wrong scene ends the job with its code" equal "$(show ExitCode)" "9:0"
check "and is named" contains "$(log)" missing.glb
mkdir -m 755 "$scratch/open"
PREHEAT_KEYS=$scratch/open submit "$quick"
eventually ended
check "keys that are none end it, too" equal "$(show ExitCode)" "2:0"

say "the end"
printf '%s passed, %s failed\n' "$passed" "$failed"
((failed == 0))
