#!/usr/bin/env bash
# Makes the shipped sound anew: every sentence of the shipped databases, spoken by flite and compressed, under
# crates/voice/data. Build the program first, and install the synthesiser and the encoder (`apt-get install flite
# vorbis-tools`). Made with flite 2.2 and vorbis-tools 1.4.2 of Debian 12; the same versions give the same bytes.
set -euo pipefail
usage="usage: make_voices.sh LEADTIME"
leadtime=$(realpath "${1:?$usage}")
cd "$(dirname "$0")/../data"
fresh=$(mktemp -d)
trap 'rm -r "$fresh"' EXIT
for domain in highway lander steakhouse; do
    "$leadtime" taxonomy speak "$domain" --voice flite:slt -o "$fresh/$domain"
    # A serial number of its own choice would differ every time.
    oggenc --quiet --quality 0 --serial 1 --output "$fresh/$domain/sound.ogg" "$fresh/$domain/sound.wav"
    mkdir -p "$domain"
    cp "$fresh/$domain"/{sound.ogg,voice.json} "$domain/"
done
