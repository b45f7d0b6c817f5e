# shellcheck shell=bash
# What the tests here count and wait with; sourced.
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
# At least every quarter of a second, for at most two minutes.
eventually() {
  for _ in $(seq 480); do
    "$@" && return
    sleep 0.25
  done
  return 1
}
