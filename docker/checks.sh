# shellcheck shell=bash
# What the tests here count, wait and skip with; sourced.
skip() { printf 'skipped: %s\n' "$*"; exit 77; }
say() { printf '== %s s: %s\n' "$SECONDS" "$*"; }
# needs_docker: an engine, compose and the base image, or an end with the reason.
needs_docker() {
  local engine=../shared/tools/docker-engine.sh
  if ! docker info >/dev/null 2>&1 && [[ $(id -u) == 0 && -x $engine ]]; then
    "$engine" >/dev/null 2>&1 || true
  fi
  docker info >/dev/null 2>&1 || skip "no docker engine runs here"
  docker compose version >/dev/null 2>&1 || skip "no docker compose here"
  docker image inspect debian:trixie-slim >/dev/null 2>&1 || docker pull -q debian:trixie-slim ||
    skip "the image debian:trixie-slim is not here and cannot be pulled"
}
passed=0
failed=0
# check WHAT COMMAND...: passes if the command does.
check() {
  local what=$1
  shift
  if "$@"; then
    passed=$((passed + 1))
    printf 'ok    %s\n' "$what"
  else
    failed=$((failed + 1))
    printf 'FAIL  %s: %s\n' "$what" "$*"
  fi
}
equal() { [[ $1 == "$2" ]] || { printf '      "%s" is not "%s"\n' "$1" "$2"; return 1; }; }
contains() { [[ $1 == *"$2"* ]] || { printf '      no "%s" in: %s\n' "$2" "$1"; return 1; }; }
# Whether what `eventually` waits for may still come; a test that knows defines it again.
hopeful() { true; }
# eventually COMMAND...: at least every quarter of a second until it succeeds, for at most two minutes.
eventually() {
  local last
  for _ in $(seq 480); do
    last=no
    hopeful || last=yes
    "$@" && return
    [[ $last == no ]] || return
    sleep 0.25
  done
  return 1
}
