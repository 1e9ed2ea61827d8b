# The harness of the shell tests, as test.h is for C. Source it in the root of the repository. The last line of a test
# must be: report

passed=0 failed=0 skipped=0
folder=$(mktemp -d) || exit 1
trap 'rm -rf "$folder"' EXIT

# cpu_time: writes the seconds of processor time of all commands so far to $folder/cpu
cpu_time() {
    times > "$folder/times"  # not in a subshell, which would have times of its own
    awk '{ gsub(/[ms]/, " "); cpu += 60 * $1 + $2 + 60 * $3 + $4 } END { printf "%.1f\n", cpu }' "$folder/times" \
        > "$folder/cpu"
}
# check NAME COMMAND...: runs a test; shows the output of the command if it fails
check() {
    name=$1
    shift
    cpu_time
    read -r before < "$folder/cpu"
    if "$@" > "$folder/log" 2>&1; then verdict='ok  ' passed=$((passed + 1))
    else
        head -n 15 "$folder/log" | sed 's/^/  /'
        verdict=FAIL failed=$((failed + 1))
    fi
    cpu_time
    echo "$verdict $name  $(awk -v before="$before" '{ printf "%.1f", $1 - before }' "$folder/cpu") s"
}
# skip NAME WHY: reports a test as skipped, with the reason
skip() { echo "  skipped: $2"; echo "skip $1"; skipped=$((skipped + 1)); }
report() { echo "$passed passed, $failed failed, $skipped skipped"; [ "$failed" = 0 ]; exit; }

# same EXPECTED ACTUAL: succeeds if two files are equal and not empty
same() { [ -s "$1" ] && [ -s "$2" ] && diff "$1" "$2"; }
# nothing FILE: prints a list of mistakes, and succeeds if it is empty
nothing() { cat "$1"; [ ! -s "$1" ]; }
