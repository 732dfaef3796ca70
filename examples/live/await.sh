# To be read by the other scripts here: `await WORDS FILE` waits for ten seconds until a log has these words, and shows it if it has not.
await() {
    for _ in $(seq 100); do
        grep -q "$1" "$2" && return
        sleep 0.1
    done
    cat "$2"
    exit 1
}
