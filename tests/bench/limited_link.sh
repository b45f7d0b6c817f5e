#!/usr/bin/env bash
# Renders with every machine's link held to a rate: a network namespace for the master and one for
# each worker, joined by a bridge. `limited_link.sh check` says whether this can be done here;
# `limited_link.sh run RATE WORKERS CACHE PREHEAT render ARGS...` does it and removes all again.
set -euo pipefail
name=ph$$
created=()
pids=()

clean_up() {
  local item
  for item in "${pids[@]}"; do kill "$item" 2>/dev/null || true; done
  wait 2>/dev/null || true
  for item in "${created[@]}"; do ip netns delete "$item" 2>/dev/null || true; done
}
trap clean_up EXIT
trap 'exit 143' TERM
trap 'exit 130' INT

namespace() {
  ip netns add "$1"
  created+=("$1")
  ip -n "$1" link set lo up
}

# join NAMESPACE NUMBER RATE: address 10.77.0.NUMBER, sends no faster than RATE, nor does the bridge
# to it.
join() {
  ip link add "$name" netns "$1" type veth peer name "port$2" netns "$name"
  ip -n "$1" address add "10.77.0.$2/24" dev "$name"
  ip -n "$1" link set "$name" up
  ip -n "$name" link set "port$2" master bridge up
  local side
  for side in "$1 $name" "$name port$2"; do
    read -r inside device <<<"$side"
    tc -n "$inside" qdisc add dev "$device" root tbf rate "$3" burst 256kb latency 50ms
  done
}

build() {
  local rate=$1 workers=$2 number
  namespace "$name"
  ip -n "$name" link add bridge type bridge
  ip -n "$name" link set bridge up
  for ((number = 1; number <= workers + 1; ++number)); do
    namespace "$name-$number"
    join "$name-$number" "$number" "$rate"
  done
}

case $1 in
  check)
    command -v ip >/dev/null && command -v tc >/dev/null || { echo "no ip or tc"; exit 1; }
    [[ $(id -u) == 0 ]] || { echo "needs root"; exit 1; }
    build 1gbit 1
    ;;
  run)
    rate=$2 workers=$3 cache=$4 preheat=$5
    shift 6
    build "$rate" "$workers"
    for ((number = 2; number <= workers + 1; ++number)); do
      ip netns exec "$name-$number" "$preheat-worker" --connect tcp://10.77.0.1:5555 \
        --cache "$cache" --threads 1 --insecure-no-auth &
      pids+=($!)
    done
    ip netns exec "$name-1" "$preheat" render "$@" --listen tcp://10.77.0.1:5555 \
      --wait-workers "$workers" --insecure-no-auth
    ;;
esac
