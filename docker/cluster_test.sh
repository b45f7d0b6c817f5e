#!/usr/bin/env bash
# Clusters of containers as their users run them, and what goes wrong with them: killed, paused, cut
# off, late, stopped, misused. Every image is compared with that of `--local` on this machine, so
# that another Embree, compiler and C library have to agree to the bit.
#
#   docker/cluster_test.sh [--brief | --no-unit-tests] [PREHEAT]
#
# PREHEAT is the program on this machine (build/release/bin/preheat). Builds the image, unit tests
# included, and ends with one line "N passed, N failed"; 1 if any failed, 77 and the reason if this
# machine cannot run containers. --no-unit-tests leaves them out of the image, for where the same
# commit is tested beside it; --brief runs those of the tracer, and renders once with two workers.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
brief=no unit_tests=all
case ${1:-} in
  --brief) brief=yes unit_tests=tracing; shift ;;
  --no-unit-tests) unit_tests=none; shift ;;
esac
program=${1:-build/release/bin/preheat}

source docker/checks.sh
needs_docker
[[ -x $program ]] || skip "$program is not built"

say "image"
started=$SECONDS
docker build -q --build-arg UNIT_TESTS="$unit_tests" -f docker/Dockerfile -t preheat . >/dev/null
printf 'built, unit tests: %s, in %s s, %s MB\n' "$unit_tests" "$((SECONDS - started))" \
  "$(($(docker image inspect -f '{{.Size}}' preheat) / 1000000))"

scratch=$(mktemp -d)
chmod 755 "$scratch"
export COMPOSE_PROJECT_NAME=preheat-test-$$ PREHEAT_IMAGE=preheat
# 20 MB if all were held: what is fetched again and again has to agree, too.
export PREHEAT_SCENE=demo:50000 PREHEAT_CACHE=8MiB
[[ $brief == yes ]] && spp=24 || spp=32
settings="--size 320x216 --spp $spp --bounces 8 --tile-size 16"
export PREHEAT_ARGS=$settings
# Until something has befallen it a cluster's workers have a twentieth of a processor each: then no
# machine is done too early, and none has to trace for the sake of time.
slow_cpus=0.05
cat >"$scratch/slow.yaml" <<YAML
services:
  worker:
    cpus: $slow_cpus
YAML
compose() { docker compose -f docker/compose.yaml -f "$scratch/slow.yaml" "$@"; }
farm() { docker compose -f docker/cluster.yaml "$@"; }
quietly() { "$@" >>"$scratch/compose.log" 2>&1; }
clean_up() {
  local code=$?
  ((code == 0 || failed > 0)) || { printf 'ended by a command that failed:\n'; tail "$scratch/compose.log"; }
  export PREHEAT_KEYS_DIR=$scratch/keys
  docker rm -f "$COMPOSE_PROJECT_NAME-port" >/dev/null 2>&1 || true
  quietly compose down --volumes --timeout 3 || true
  quietly farm --profile render down --volumes --timeout 3 || true
  rm -rf "$scratch"
}
trap clean_up EXIT
trap 'exit 1' INT TERM

sha_of() { sed -n 's/.*"pixels_sha256": "\([0-9a-f]*\)".*/\1/p' "$1/report.json"; }
id_of() { compose ps -aq "$1" | head -n "${2:-1}" | tail -n 1; }
exit_code_of() { docker inspect -f '{{.State.ExitCode}}' "$1"; }
# Nothing more comes of a cluster whose master has ended.
master=
hopeful() {
  [[ -z $master || $(docker inspect -f '{{.State.Status}}' "$master" 2>/dev/null) != exited ]]
}

# The master's word: status FIELD, where FIELD is done, here or lost.
status() {
  compose exec -T master preheat status --connect tcp://127.0.0.1:5555 2>/dev/null |
    awk -v field="$1" '$1 == "tiles" {value["done"] = $2}
      $1 == "workers" {value["here"] = $2; value["lost"] = $6}
      END {print value[field] == "" ? -1 : value[field]}'
}
is_healthy() {
  [[ $(docker inspect -f '{{.State.Health.Status}}' "$(id_of master)") == healthy ]]
}
at_least() { (($(status "$1") >= $2)); }

# begin NAME WORKERS: a cluster on its slow way, its output in $out.
begin() {
  out=$scratch/$1
  say "$1"
  mkdir "$out"
  export PREHEAT_OUT=$out
  quietly compose down --timeout 3
  quietly compose up -d --scale worker="$2"
  master=$(id_of master)
}
# As fast as the machine can from here on.
hurry() {
  local worker
  for worker in $(compose ps -q worker); do
    quietly docker update --cpus "$(nproc)" "$worker" || true
  done
}
# end_well: the render ends with 0 and the image of --local. Unlike `docker compose wait`, this knows
# of masters that have ended before they are asked for.
end_well() {
  local code
  hurry
  code=$(timeout 600 docker wait "$master" || true)
  check "the master ends with 0" equal "$code" 0
  [[ $code == 0 ]] || compose logs --tail 20 master
  check "the image is that of --local outside" equal "$(sha_of "$out")" "$expected"
}

say "reference"
mkdir "$scratch/local"
# shellcheck disable=SC2086  # several words
XDG_CACHE_HOME=$scratch/stores "$program" render "$PREHEAT_SCENE" --local \
  -o "$scratch/local/image.png" --report "$scratch/local/report.json" $settings 2>/dev/null
expected=$(sha_of "$scratch/local")
printf 'sha256 %s\n' "$expected"

say "what the image is"
inspect() { docker image inspect -f "$1" preheat; }
check "user 10001" equal "$(inspect '{{.Config.User}}')" 10001
check "stop signal" equal "$(inspect '{{.Config.StopSignal}}')" SIGTERM
check "health is asked of preheat itself" contains "$(inspect '{{.Config.Healthcheck.Test}}')" \
  "[CMD preheat status"
check "labels" contains "$(inspect '{{.Config.Labels}}')" "org.opencontainers.image.title:preheat"
bare=(docker run --rm --read-only --cap-drop ALL)
check "starts without a shell" contains "$("${bare[@]}" --network none preheat preheat --version)" "preheat 0."

# whole_cluster WORKERS
whole_cluster() {
  begin "$1 workers" "$1"
  timeout 600 docker compose -f docker/compose.yaml wait master >/dev/null 2>&1 &
  local waiting=$! waited=0
  check "the master is healthy while it renders" eventually is_healthy
  check "no process is root's" equal \
    "$(for id in $(compose ps -q master worker); do docker top "$id" -eo pid,uid; done |
       awk 'NF == 2 && $2 != "UID" {print $2}' | sort -u | tr '\n' ' ')" "10001 "
  check "the root file system is read-only" equal \
    "$(docker inspect -f '{{.HostConfig.ReadonlyRootfs}}' "$(id_of master)" "$(id_of worker)" |
       sort -u)" true
  check "a worker's memory is bounded" equal \
    "$(docker inspect -f '{{.HostConfig.Memory}}' "$(id_of worker)")" 1073741824
  check "a worker does not hold the master's key" equal \
    "$(compose exec -T worker find /keys -name 'master.key' | wc -l)" 0
  hurry
  wait "$waiting" || waited=$?
  check "compose gives the master's exit code" equal "$waited" 0
  end_well
  check "nothing was written beside the output and the store" equal \
    "$(docker diff "$(id_of master)")" ""
  check "image and report are there, and nothing else" equal "$(cd "$out" && echo *)" \
    "image.png report.json"
  check "they belong to user 10001" equal "$(stat -c %u "$out"/* | sort -u)" 10001
  check "connections were encrypted" contains "$(<"$out/report.json")" '"security": "curve"'
  check "all of them took part" equal "$(grep -c '"tiles":' "$out/report.json")" "$1"
}

worker_killed() {
  begin "a worker killed" 4
  check "it renders" eventually at_least "done" 5
  quietly docker kill -s KILL "$(id_of worker 2)" || true
  check "the master notices" eventually at_least lost 1
  end_well
}

workers_paused() {
  begin "all workers paused" 2
  check "it renders" eventually at_least "done" 5
  local worker
  for worker in $(compose ps -q worker); do
    # A process that waits for its share of a processor cannot be frozen.
    quietly docker update --cpus "$(nproc)" "$worker" || true
    check "it is paused" quietly docker pause "$worker"
    quietly docker update --cpus "$slow_cpus" "$worker" || true
  done
  check "the master notices" eventually at_least lost 2
  quietly compose unpause worker || true
  check "they come back" eventually at_least here 2
  end_well
}

worker_cut_off() {
  begin "the only worker cut off" 1
  check "it renders" eventually at_least "done" 5
  quietly docker network disconnect "${COMPOSE_PROJECT_NAME}_farm" "$(id_of worker)" || true
  check "the master notices" eventually at_least lost 1
  quietly docker network connect "${COMPOSE_PROJECT_NAME}_farm" "$(id_of worker)" || true
  end_well
}

worker_late() {
  begin "a worker that comes late" 1
  check "it renders" eventually at_least "done" 5
  quietly compose up -d --no-recreate --scale worker=2
  check "it is let in" eventually at_least here 2
  end_well
  check "both took part" equal "$(grep -c '"tiles": [1-9]' "$out/report.json")" 2
}

master_stopped() {
  begin "the master stopped" 2
  check "it renders" eventually at_least "done" 5
  quietly docker stop "$master"
  check "it ended in order within its ten seconds" equal "$(exit_code_of "$master")" 143
  check "its workers ended with it" equal \
    "$(for worker in 1 2; do docker wait "$(id_of worker $worker)"; done | tr '\n' ' ')" "0 0 "
  check "there is no half image" equal "$(cd "$out" && echo *)" "*"
  quietly compose down --timeout 3
}

misuse() {
  say "misuse"
  master=
  # refused CODE TEXT OPTIONS... -- COMMAND...: a container ends with CODE and says TEXT.
  refused() {
    local code=$1 text=$2 said got=0 options=()
    shift 2
    while [[ $1 != -- ]]; do options+=("$1"); shift; done
    shift
    said=$("${bare[@]}" "${options[@]}" preheat "$@" 2>&1) || got=$?
    equal "$got" "$code" && contains "$said" "$text"
  }
  local writable=(--tmpfs /tmp -e XDG_CACHE_HOME=/tmp)
  local alone=("${writable[@]}" --network none)
  local render=(preheat render demo:50000 -o /tmp/a.png --size 16x16 --spp 1)
  check "a wrong scene path is named" refused 9 /scenes/nothing.glb "${alone[@]}" -- \
    preheat render /scenes/nothing.glb -o /tmp/a.png
  check "an output that cannot be written" refused 6 /out/a.png "${alone[@]}" -- \
    "${render[@]}" -o /out/a.png
  check "no workers in time" refused 3 "no workers in time" "${alone[@]}" \
    -e PREHEAT_TIME_SCALE=60 -- "${render[@]}" --listen tcp://127.0.0.1:5555
  check "an open address without keys" refused 2 "--insecure-no-auth" "${alone[@]}" -- \
    "${render[@]}" --listen tcp://0.0.0.0:5555
  check "a worker that finds no master" refused 4 "no word from the master" --network none -- \
    preheat-worker --connect tcp://127.0.0.1:5555 --give-up 1
  docker run -d --name "$COMPOSE_PROJECT_NAME-port" "${alone[@]}" preheat \
    "${render[@]}" --listen tcp://127.0.0.1:5555 >/dev/null
  check "the port is another master's" eventually quietly docker exec \
    "$COMPOSE_PROJECT_NAME-port" preheat status --connect tcp://127.0.0.1:5555
  check "a port that is taken" refused 2 "Address already in use" "${writable[@]}" \
    --network "container:$COMPOSE_PROJECT_NAME-port" -- "${render[@]}" --listen tcp://127.0.0.1:5555
  docker rm -f "$COMPOSE_PROJECT_NAME-port" >/dev/null
  too_large() { PREHEAT_CACHE=2GiB compose create worker 2>&1; }
  check "a cache larger than the memory" contains "$(too_large || true)" "memory"
}

workers_that_stay() {
  say "workers that stay"
  export PREHEAT_USER PREHEAT_KEYS_DIR=$scratch/keys PREHEAT_OUT=$scratch/stay
  PREHEAT_USER=$(id -u)
  mkdir -m 700 "$PREHEAT_KEYS_DIR"
  mkdir "$PREHEAT_OUT"
  if ((PREHEAT_USER == 0)); then
    PREHEAT_USER=10001
    chown 10001 "$PREHEAT_KEYS_DIR" "$PREHEAT_OUT"
  fi
  docker run --rm --user "$PREHEAT_USER" -v "$PREHEAT_KEYS_DIR:/keys" preheat preheat keygen /keys \
    2>/dev/null
  quietly farm up -d --scale worker=2
  local before image
  before=$(farm ps -q worker | sort)
  for image in first second; do
    # shellcheck disable=SC2086
    check "the $image master ends with 0" quietly farm run --rm --use-aliases master \
      preheat render "$PREHEAT_SCENE" -o "/out/$image.png" --report /out/report.json \
      --listen tcp://0.0.0.0:5555 $settings --spp 4 --wait-workers 2
    check "the $image image is rendered by both workers" equal \
      "$(grep -c '"tiles": [1-9]' "$PREHEAT_OUT/report.json")" 2
  done
  check "the workers are still the same" equal "$(farm ps -q worker | sort)" "$before"
  # shellcheck disable=SC2086
  check "none of them was started again" equal \
    "$(docker inspect -f '{{.RestartCount}}' $before | sort -u)" 0
  check "they knew where others reach them, though they were there before the master's name" equal \
    "$(farm logs worker | grep -c no_peer_socket)" 0
}

if [[ $brief == yes ]]; then
  whole_cluster 2
else
  whole_cluster 4
  worker_killed
  workers_paused
  worker_cut_off
  worker_late
  master_stopped
  misuse
  workers_that_stay
fi

say "the end"
printf '%s passed, %s failed\n' "$passed" "$failed"
((failed == 0))
