/* The raw bytes between a robot and a notifier at work: an observation with what is beside it, and an event of what is said.
 * Plain C99 and nothing of Zenoh, so that it can be compiled and tried anywhere (check_c.sh). The layouts: docs/live.md. */
#ifndef LEADTIME_WIRE_H
#define LEADTIME_WIRE_H
#include <stdint.h>
#include <string.h>

enum { LT_BESIDE = 40, LT_EVENT = 24, LT_END = 1 };
enum { LT_SILENT = 0, LT_START, LT_WORD, LT_FINISHED, LT_CUT };

static inline void lt_put(uint8_t *to, uint64_t value, int n) {
    for (int i = 0; i < n; i++) to[i] = (uint8_t)(value >> (8 * i));
}

static inline uint64_t lt_get(const uint8_t *from, int n) {
    uint64_t value = 0;
    for (int i = n; i-- > 0;) value = value << 8 | from[i];
    return value;
}

/* CRC-32C, bit by bit: a table is faster and takes 1 kB. Begin with 0. */
static inline uint32_t lt_crc32c(uint32_t crc, const uint8_t *bytes, size_t n) {
    crc = ~crc;
    while (n-- > 0) {
        crc ^= *bytes++;
        for (int i = 0; i < 8; i++) crc = crc >> 1 ^ (crc & 1 ? 0x82f63b78u : 0);
    }
    return ~crc;
}

/* Writes n numbers (4 n bytes) and what goes beside them. t: the robot's own time in ns, which only goes on. */
static inline void lt_observation(const float *numbers, size_t n, uint64_t seq, uint64_t t, uint64_t episode, int end,
                                  uint8_t *payload, uint8_t beside[LT_BESIDE]) {
    for (size_t i = 0; i < n; i++) {
        uint32_t bits;
        memcpy(&bits, &numbers[i], 4);
        lt_put(payload + 4 * i, bits, 4);
    }
    memcpy(beside, "LDLV", 4);
    lt_put(beside + 4, 1, 2);
    lt_put(beside + 6, end ? LT_END : 0, 2);
    lt_put(beside + 8, seq, 8);
    lt_put(beside + 16, t, 8);
    lt_put(beside + 24, episode, 8);
    lt_put(beside + 32, lt_crc32c(lt_crc32c(0, beside, 32), payload, 4 * n), 4);
    lt_put(beside + 36, 0, 4);
}

typedef struct {
    uint32_t utterance, step;
    uint64_t seq;
    uint16_t word;
    uint8_t event, topic, k, l, heard, last;
} lt_event_t;

static inline lt_event_t lt_event(const uint8_t bytes[LT_EVENT]) {
    lt_event_t event = {
        .utterance = (uint32_t)lt_get(bytes, 4), .step = (uint32_t)lt_get(bytes + 10, 4), .seq = lt_get(bytes + 14, 8),
        .word = (uint16_t)lt_get(bytes + 22, 2), .event = bytes[4], .topic = bytes[5], .k = bytes[6], .l = bytes[7],
        .heard = bytes[8], .last = bytes[9] & 1};
    return event;
}
#endif
