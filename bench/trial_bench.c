/*
 * How fast the whole thing runs without Python: firmware, simulated board, fish and a host made of
 * as little as will do, over whole trials of learning. Usage: tailbeat_bench [trials] [thesis];
 * tailbeat_bench divider
 */
#include "divider.h"
#include "mini_host.h"
#include "store/records.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define BEATS 40u
#define PLATEAU_M_S 0.0791

/* Mean of (8.31) over beat |k|. */
static float mean_of_beat(unsigned k) {
    enum { STEPS = 1000 };
    double sum = 0;
    for (int i = 0; i < STEPS; i++) {
        const double t = k + (i + 0.5) / STEPS;
        const double rise = t * (t - 40);
        sum += t > 10 && t < 30 ? PLATEAU_M_S : 2.25 * rise * rise / (40.0 * 40 * 40 * 40);
    }
    return (float)(sum / STEPS);
}

static float wanted[BEATS];

static bool prepare(mini_host_t *host, bool thesis) {
    static reference_t reference;
    uint8_t record[RECORD_HEADER_BYTES + 4u * (BEATS + 1u)];
    reference.beats = BEATS;
    reference.beat_s = 1.0f;
    for (unsigned k = 0; k < BEATS; k++) {
        wanted[k] = reference.speed_m_s[k] = mean_of_beat(k);
    }
    const size_t length = record_encode_reference(&reference, record);
    return mini_host_await(host, MAVLINK_MSG_ID_HEARTBEAT, 10) &&
           mini_host_set_param(host, "AMP_MAX_RAD", 0.78539816f) &&
           mini_host_set_param(host, "DU_MAX_RAD", 0.0f) &&
           mini_host_set_param(host, "ILC_LEAD", thesis ? 0.0f : 1.0f) &&
           mini_host_upload(host, "/in/reference.bin", TAILBEAT_FILE_REFERENCE, record,
                            (uint8_t)length);
}

static bool await_state(mini_host_t *host, uint8_t state, double limit_s) {
    const uint64_t end_us = sim_time_us(host->sim) + (uint64_t)(limit_s * 1e6);
    while (host->status.state != state) {
        if (sim_time_us(host->sim) >= end_us) {
            return false;
        }
        (void)mini_host_await(host, MAVLINK_MSG_ID_TAILBEAT_STATUS, 2);
    }
    return true;
}

static bool swim_and_learn(mini_host_t *host) {
    if (!mini_host_await(host, MAVLINK_MSG_ID_TAILBEAT_STATUS, 3)) {
        return false;
    }
    const float trial = (float)host->status.next_trial;
    if (!mini_host_command(host, MAV_CMD_COMPONENT_ARM_DISARM, 1, 0)) {
        return false;
    }
    const float now_s = (float)sim_board_time_us(host->sim) * 1e-6f;
    return mini_host_command(host, TAILBEAT_CMD_TRIAL_START, trial, now_s) &&
           await_state(host, TAILBEAT_STATE_RUNNING, 3) &&
           await_state(host, TAILBEAT_STATE_IDLE, 60) &&
           mini_host_command(host, TAILBEAT_CMD_LEARN, trial, 0);
}

static double true_error(const sim_t *sim) {
    double beat[BEATS], worst = 0;
    const size_t count = sim_true_beats(sim, beat, BEATS);
    for (unsigned k = 0; k < BEATS && k < count; k++) {
        worst = fmax(worst, fabs((double)wanted[k] - beat[k]));
    }
    return worst;
}

static double cpu_s(void) { return (double)clock() / CLOCKS_PER_SEC; }

static int run(sim_t *sim, bool thesis, int trials) {
    mini_host_t host;
    mini_host_init(&host, sim);
    if (!prepare(&host, thesis)) {
        fprintf(stderr, "the board did not take the reference\n");
        return EXIT_FAILURE;
    }
    const double begin_s = (double)sim_time_us(sim) * 1e-6;
    const double begin_cpu_s = cpu_s();
    host.wakes = 0;
    for (int i = 0; i < trials; i++) {
        if (!swim_and_learn(&host)) {
            fprintf(stderr, "trial %d failed: state %u, fault %u\n", i + 1, host.status.state,
                    host.status.fault);
            return EXIT_FAILURE;
        }
        printf("trial %d: max|e| %.1f mm/s measured, %.1f mm/s true\n", i + 1,
               1e3 * (double)host.learned.max_abs_error_m_s, 1e3 * true_error(sim));
    }
    const double simulated_s = (double)sim_time_us(sim) * 1e-6 - begin_s;
    const double spent_s = cpu_s() - begin_cpu_s;
    printf("C alone: %.0f x real time (%.1f s in %.1f ms, %.0f us a simulated second, %.1f host "
           "wakes a simulated second)\n",
           simulated_s / spent_s, simulated_s, 1e3 * spent_s, 1e6 * spent_s / simulated_s,
           host.wakes / simulated_s);
    return EXIT_SUCCESS;
}

int main(int argc, char **argv) {
    if (argc > 1 && strcmp(argv[1], "divider") == 0) {
        printf("%.4f ns for the quotient and the root of a substep\n", 1e9 * divider_substep_s());
        return EXIT_SUCCESS;
    }
    const int trials = argc > 1 ? atoi(argv[1]) : 6;
    const bool thesis = argc > 2 && strcmp(argv[2], "thesis") == 0;
    sim_config_t config;
    sim_config_default(&config, thesis ? SIM_PLANT_THESIS : SIM_PLANT_TANK);
    sim_t *sim = sim_new(&config);
    if (sim == NULL) {
        fprintf(stderr, "out of memory\n");
        return EXIT_FAILURE;
    }
    const int result = run(sim, thesis, trials);
    sim_free(sim);
    return result;
}
