#!/usr/bin/env bash
# Tries the C client. Usage: examples/live/check_c.sh PROGRAM
# Its bytes (wire.h) are compared with Python's struct. Where zenoh-pico is installed, the client itself is compiled and spoken to.
set -euo pipefail
program=$(realpath "$1")
cd "$(dirname "$0")/../.."
. examples/live/await.sh
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
flags="-std=c11 -O1 -Wall -Wextra -Werror"
cc $flags examples/live/wire_check.c -o "$place/wire"
cat >"$place/expected.py" <<'PYTHON'
import struct, subprocess, sys
def crc32c(data):
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x82F63B78 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF
assert crc32c(b"123456789") == 0xE3069283
numbers = struct.pack("<3f", 0.1, -3.0, 1e9)
head = struct.pack("<4sHHQQQ", b"LDLV", 1, 1, 1 << 40 | 17, 12340000000, 3)
beside = head + struct.pack("<II", crc32c(head + numbers), 0)
event = (4000000000, 4, 2, 3, 5, 1, 1, 52, 1 << 40 | 17, 65535)
told = subprocess.run([sys.argv[1]], input=struct.pack("<IBBBBBBIQH", *event), stdout=subprocess.PIPE, check=True).stdout
expected = f"{numbers.hex()}\n{beside.hex()}\n{' '.join(map(str, event))}\n"
assert told.decode() == expected, f"{told.decode()}is not\n{expected}"
print("wire.h: the bytes of an observation and of an event are those of struct")
PYTHON
python3 "$place/expected.py" "$place/wire"
if ! pkg-config --exists zenohpico 2>/dev/null; then
    echo "client.c: skipped, zenoh-pico is not installed here"
    exit 0
fi
cc $flags -DZENOH_LINUX examples/live/client.c $(pkg-config --cflags --libs zenohpico) -lm -o "$place/client"
"$program" serve deploy/policies/piloting.safetensors --listen tcp/127.0.0.1:0 2>"$place/log" &
notifier=$!
trap 'kill $notifier; wait $notifier || true; rm -rf "$place"' EXIT
await "is at work at" "$place/log"
"$place/client" "$(sed -n 's/.* is at work at \(tcp[^ ]*\).*/\1/p' "$place/log")"
