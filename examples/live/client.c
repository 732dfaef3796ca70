/* A robot without JSON: sends numbers, is told in 24 bytes what to play. For zenoh-pico 1.9 or later.
 *
 *     leadtime serve deploy/policies/piloting.safetensors --listen tcp/127.0.0.1:7448
 *     cc -std=c11 examples/live/client.c $(pkg-config --cflags --libs zenohpico) -DZENOH_LINUX -lm -o client
 *     ./client tcp/127.0.0.1:7448
 *
 * What zenoh-pico does not say loudly: without the read and the lease task nothing is received, and the session ends with its
 * lease. Messages of more than FRAG_MAX_SIZE (4,096 bytes) are lost; all that is sent here to a client of encoding `binary` is
 * below 2,000. TLS has to be compiled in (Z_FEATURE_LINK_TLS). Transport `lowlatency` does not go together with Zenoh 1.10. */
#include <math.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <zenoh-pico.h>

#include "wire.h"

#define KEY "leadtime/live/1/notifier/robot-c"
#define N 8
#define STEPS 100

static atomic_uint n_events, n_started, n_damaged;

/* What is said. A robot plays its own recording of (topic, k, l) here, and stops it on LT_CUT. */
static void on_say(z_loaned_sample_t *sample, void *context) {
    (void)context;
    uint8_t bytes[LT_EVENT];
    z_bytes_reader_t reader = z_bytes_get_reader(z_sample_payload(sample));
    if (z_bytes_len(z_sample_payload(sample)) != LT_EVENT || z_bytes_reader_read(&reader, bytes, LT_EVENT) != LT_EVENT) {
        atomic_fetch_add(&n_damaged, 1);
        return;
    }
    lt_event_t said = lt_event(bytes);
    atomic_fetch_add(&n_events, 1);
    if (said.event == LT_START) {
        atomic_fetch_add(&n_started, 1);
        printf("%3u  topic %u, understood after %u of %u words\n", said.step, said.topic, said.k, said.l);
    } else if (said.event == LT_CUT) {
        printf("%3u  ... cut after %u words\n", said.step, said.heard);
    }
}

static int fail(const char *what) {
    fprintf(stderr, "cannot %s\n", what);
    return 1;
}

/* Asks for a session, and prints the notifier's sentence if it says no. */
static int open_session(const z_loaned_session_t *session, const char *start) {
    char question[256];
    snprintf(question, sizeof question,
             "{\"protocol\":1,\"domain\":\"lander\",\"obs_dim\":%d,\"incarnation\":\"%s\",\"encoding\":\"binary\",\"seed\":1,"
             "\"seconds_per_step\":0.05}", N, start);
    z_view_keyexpr_t key;
    z_view_keyexpr_from_str(&key, KEY "/open");
    z_get_options_t options;
    z_get_options_default(&options);
    z_owned_bytes_t payload;
    z_bytes_copy_from_str(&payload, question);
    options.payload = z_move(payload);
    z_owned_closure_reply_t closure;
    z_owned_fifo_handler_reply_t answers;
    z_fifo_channel_reply_new(&closure, &answers, 1);
    if (z_get(session, z_loan(key), "", z_move(closure), &options) < 0) return fail("ask for a session");
    z_owned_reply_t reply;
    if (z_recv(z_loan(answers), &reply) != Z_OK) return fail("find a notifier here");
    int is_open = z_reply_is_ok(z_loan(reply));
    const z_loaned_bytes_t *told =
        is_open ? z_sample_payload(z_reply_ok(z_loan(reply))) : z_reply_err_payload(z_reply_err(z_loan(reply)));
    z_owned_string_t text;
    z_bytes_to_string(told, &text);
    printf("%s%.*s\n", is_open ? "" : "refused: ", (int)z_string_len(z_loan(text)), z_string_data(z_loan(text)));
    z_drop(z_move(text));
    z_drop(z_move(reply));
    z_drop(z_move(answers));
    return !is_open;
}

int main(int argc, char **argv) {
    if (argc != 2) return fail("start: client ENDPOINT");
    z_owned_config_t config;
    z_config_default(&config);
    zp_config_insert(z_loan_mut(config), Z_CONFIG_MODE_KEY, "client");
    zp_config_insert(z_loan_mut(config), Z_CONFIG_CONNECT_KEY, argv[1]);
    z_owned_session_t session;
    if (z_open(&session, z_move(config), NULL) < 0) return fail("reach the notifier");
    if (zp_start_read_task(z_loan_mut(session), NULL) < 0 || zp_start_lease_task(z_loan_mut(session), NULL) < 0)
        return fail("start the tasks");
    /* Kept as long as it speaks: without it, nobody knows that this robot is there. */
    char start[17], alive[96];
    snprintf(start, sizeof start, "%016llx", (unsigned long long)z_random_u64());
    snprintf(alive, sizeof alive, KEY "/alive/%s", start);
    z_view_keyexpr_t key;
    z_view_keyexpr_from_str(&key, alive);
    z_owned_liveliness_token_t token;
    if (z_liveliness_declare_token(z_loan(session), &token, z_loan(key), NULL) < 0) return fail("show presence");
    z_view_keyexpr_from_str(&key, KEY "/say");
    z_owned_closure_sample_t say;
    z_closure(&say, on_say, NULL, NULL);
    if (z_declare_background_subscriber(z_loan(session), z_loan(key), z_move(say), NULL) < 0) return fail("listen");
    if (open_session(z_loan(session), start) != 0) return 1;
    z_view_keyexpr_from_str(&key, KEY "/obs");
    z_publisher_options_t qos;
    z_publisher_options_default(&qos);
    qos.priority = Z_PRIORITY_REAL_TIME;
    qos.is_express = true;
    z_owned_publisher_t sights;
    if (z_declare_publisher(z_loan(session), &sights, z_loan(key), &qos) < 0) return fail("publish");
    z_clock_t began = z_clock_now();
    for (int step = 0; step < STEPS; step++) {
        const float seen[N] = {0.4f * sinf(step / 15.0f), fmaxf(0.0f, 1.4f - step / 80.0f), 0.1f * cosf(step / 15.0f), -0.2f};
        uint8_t numbers[4 * N], beside[LT_BESIDE];
        uint64_t t = (uint64_t)z_clock_elapsed_us(&began) * 1000;
        lt_observation(seen, N, (uint64_t)step + 1, t, 0, step == STEPS - 1, numbers, beside);
        z_publisher_put_options_t options;
        z_publisher_put_options_default(&options);
        z_owned_bytes_t payload, attachment;
        z_owned_encoding_t encoding;
        z_bytes_copy_from_buf(&payload, numbers, sizeof numbers);
        z_bytes_copy_from_buf(&attachment, beside, sizeof beside);
        z_encoding_from_str(&encoding, "application/octet-stream;leadtime.obs/1");
        options.attachment = z_move(attachment);
        options.encoding = z_move(encoding);
        if (z_publisher_put(z_loan(sights), z_move(payload), &options) < 0) return fail("send an observation");
        z_sleep_ms(50);
    }
    printf("%u events, %u sentences, %u damaged\n", n_events, n_started, n_damaged);
    z_drop(z_move(sights));
    z_drop(z_move(token));
    z_drop(z_move(session));
    return n_started > 0 && n_damaged == 0 ? 0 : 1;
}
