#!/usr/bin/env bash
# preheat-worker.service as its users install and run it, by a systemd of its own that is PID 1 of a
# container: installed by the lines at its beginning, serving one master after the other, killed,
# misconfigured, stopped.
#
#   docker/systemd_test.sh
#
# Takes the image `preheat` that docker/cluster_test.sh built, and ends with one line "N passed,
# N failed"; 1 if any failed, 77 and the reason if systemd cannot run in a container here.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

source docker/checks.sh
needs_docker
docker image inspect preheat >/dev/null 2>&1 || skip "there is no image preheat: see docker/Dockerfile"

say "image"
docker build -q -t preheat-systemd - >/dev/null 2>&1 <<'FILE' || skip "systemd cannot be installed in a container here"
FROM preheat
USER root
RUN apt-get update -q \
 && DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends systemd \
 && rm -rf /var/lib/apt/lists/*
WORKDIR /src
ENV container=docker
STOPSIGNAL SIGRTMIN+3
HEALTHCHECK NONE
# Units get their credentials by a mount that has to reach their namespaces, as from any other root.
CMD ["sh", "-c", "mount --make-rshared / && exec /lib/systemd/systemd"]
FILE

box=preheat-systemd-$$ unit=preheat-worker
quietly() { "$@" >/dev/null 2>&1; }
inside() { docker exec "$box" "$@"; }
clean_up() {
  local code=$?
  ((code == 0)) || inside journalctl --no-pager -u "$unit" -n 20 2>/dev/null || true
  docker rm -f "$box" >/dev/null 2>&1 || true
}
trap clean_up EXIT
trap 'exit 1' INT TERM

say "systemd"
# What it takes to be PID 1 and to set up sandboxes: mounts and control groups of its own, a look at
# processes whose /proc is hidden, system calls that containers rarely make.
docker run -d --name "$box" --cap-add SYS_ADMIN --cap-add SYS_PTRACE --cgroupns private --security-opt seccomp=unconfined \
  --security-opt apparmor=unconfined --security-opt systempaths=unconfined --tmpfs /run --tmpfs /tmp \
  --add-host render0:127.0.0.1 preheat-systemd >/dev/null || skip "no such container can be run here"
hopeful() { [[ $(docker inspect -f '{{.State.Status}}' "$box") == running ]]; }
is_up() { [[ $(inside systemctl is-system-running 2>/dev/null) == @(running|degraded) ]]; }
eventually is_up || { docker logs --tail 5 "$box" 2>&1; skip "systemd does not start in a container here"; }
inside systemctl --version | head -n 1

show() { inside systemctl show --value -p "$1" "$unit"; }
is_active() { [[ $(inside systemctl is-active "$unit") == active ]]; }
is_failed() { [[ $(inside systemctl is-failed "$unit") == failed ]]; }
# Of the process: what the kernel knows, not what the unit asks for.
process() { inside sed -n "s/^$1:[[:space:]]*//p" "/proc/$(show MainPID)/status"; }

say "installation"
inside mkdir -p docker build/release/bin
inside cp /usr/local/bin/preheat-worker build/release/bin/
docker cp "docker/$unit.service" "$box:/src/docker/" >/dev/null 2>&1
inside preheat keygen keys >/dev/null 2>&1
# Half a minute between two attempts is long for a test.
inside sh -ec 'mkdir -p /etc/systemd/system/preheat-worker.service.d
  printf "[Service]\nRestartSec=1\n" > /etc/systemd/system/preheat-worker.service.d/test.conf'
installation=$(sed -n '/^\[Unit\]/q; s/^#   //p' "docker/$unit.service")
check "its first lines install and start it" quietly inside sh -ec "$installation"
check "systemd finds no fault in it" equal "$(inside systemd-analyze verify "$unit.service" 2>&1)" ""
check "it stays while there is no master" eventually is_active
check "it is started with the machine" equal "$(inside systemctl is-enabled "$unit")" enabled

say "rights"
started=$(show MainPID)
check "no right is left" equal "$(process CapBnd) $(process NoNewPrivs)" "0000000000000000 1"
check "system calls are filtered" equal "$(process Seccomp)" 2
check "its user is its own" equal "$(($(process Uid | cut -f 1) >= 61184))" 1
check "its keys are readable for it alone" equal \
  "$(inside stat -c %a /run/preheat-worker /run/preheat-worker/worker/worker.key | tr '\n' ' ')" "700 600 "
check "those of root still are root's" equal "$(inside stat -c '%a %u' /etc/preheat/worker.key)" "600 0"
check "its memory is bounded" equal "$(show MemoryMax)" 2147483648

say "renders"
render=(preheat render demo:50000 --size 64x64 --spp 4 --store-cache /tmp/stores)
inside "${render[@]}" --local -o /tmp/local.exr --report /tmp/local.json >/dev/null 2>&1
sha_of() { inside sed -n 's/.*"pixels_sha256": "\([0-9a-f]*\)".*/\1/p' "$1"; }
# rendered NAME: a master with keys renders by whoever comes.
rendered() {
  docker exec -e PREHEAT_KEYS=keys "$box" "${render[@]}" --listen tcp://127.0.0.1:5555 \
    -o "/tmp/$1.exr" --report "/tmp/$1.json" >/dev/null 2>&1 &&
    equal "$(sha_of "/tmp/$1.json")" "$(sha_of /tmp/local.json)"
}
check "it serves a master, and the image is that of --local" rendered first
check "and the next one" rendered second
check "it is still the same process" equal "$(show MainPID)" "$started"

say "trouble"
restarted() { [[ $(show NRestarts) == "$1" ]] && is_active; }
inside systemctl kill --signal=KILL "$unit"
check "killed, it is started again" eventually restarted 1
check "and serves a master" rendered third
inside systemctl stop "$unit"
check "stopped, it ends in order" equal "$(show Result) $(inside systemctl is-active "$unit" || true)" \
  "success inactive"
check "its copies of the keys are gone" equal "$(inside ls /run | grep -c preheat || true)" 0
inside sh -c 'echo PREHEAT_CACHE=plenty >> /etc/preheat/worker.env'
inside systemctl start "$unit" >/dev/null 2>&1 || true
check "settings that are wrong end it" eventually is_failed
check "with code 2, and it is not tried again" equal "$(show ExecMainStatus) $(show NRestarts)" "2 0"

say "the end"
printf '%s passed, %s failed\n' "$passed" "$failed"
((failed == 0))
