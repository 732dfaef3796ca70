/* Prints an observation and what is beside it, and an event that is read from standard input: for check_c.sh. */
#include <inttypes.h>
#include <stdio.h>

#include "wire.h"

int main(void) {
    const float numbers[3] = {0.1f, -3.0f, 1e9f};
    uint8_t payload[12], beside[LT_BESIDE], bytes[LT_EVENT];
    lt_observation(numbers, 3, UINT64_C(1) << 40 | 17, UINT64_C(12340000000), 3, 1, payload, beside);
    for (int i = 0; i < 12; i++) printf("%02x", payload[i]);
    printf("\n");
    for (int i = 0; i < LT_BESIDE; i++) printf("%02x", beside[i]);
    if (fread(bytes, 1, LT_EVENT, stdin) != LT_EVENT) return 1;
    lt_event_t said = lt_event(bytes);
    printf("\n%" PRIu32 " %u %u %u %u %u %u %" PRIu32 " %" PRIu64 " %u\n", said.utterance, said.event, said.topic, said.k,
           said.l, said.heard, said.last, said.step, said.seq, said.word);
    return 0;
}
