/*
 * The simulated board with the conformance suite in it, as a program: the runner talks to it by
 * lines on standard input and output and lets simulated time pass.
 *
 *   run US        answers "TIME_US HEX": until bytes have come from the console, or US have passed
 *   write HEX     bytes for the console
 *   pulses        answers "TIME_US:TICKS ...": frames with a pulse since the last time
 *   light         answers how often the LED has changed
 *   power         the power goes off and on
 *
 * An argument is the number of a planted fault (faults/faults.h).
 */
#include "faults/faults.h"
#include "sim.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define CONSOLE 1
#define BYTES_PER_S 11520.0
#define BATTERY_V 8.2
#define LINE_BYTES 65536
#define BLOCK_BYTES 4096
#define PULSES_MAX 4096

typedef struct {
    uint64_t time_us;
    uint16_t ticks;
} pulse_t;

static pulse_t pulses[PULSES_MAX];
static size_t pulse_count;
static unsigned light_changes;
static bool light;
static uint32_t fault;

uint32_t planted_fault(void) { return fault; }

/* What the board does to the world comes by here (the linker's --wrap). */
void __real_world_frame(world_t *world, uint64_t now_us, uint16_t next_pulse_ticks);
void __wrap_world_frame(world_t *world, uint64_t now_us, uint16_t next_pulse_ticks);
void __real_world_led(world_t *world, uint64_t now_us, bool on);
void __wrap_world_led(world_t *world, uint64_t now_us, bool on);

void __wrap_world_frame(world_t *world, uint64_t now_us, uint16_t next_pulse_ticks) {
    if (next_pulse_ticks > 0 && pulse_count < PULSES_MAX) {
        pulses[pulse_count++] = (pulse_t){now_us, next_pulse_ticks};
    }
    __real_world_frame(world, now_us, next_pulse_ticks);
}

void __wrap_world_led(world_t *world, uint64_t now_us, bool on) {
    light_changes += on != light ? 1u : 0u;
    light = on;
    __real_world_led(world, now_us, on);
}

static sim_t *new_board(void) {
    sim_config_t config;
    sim_config_default(&config, SIM_PLANT_TANK);
    config.link_bytes_per_s = BYTES_PER_S;
    config.battery_v = BATTERY_V;
    config.imu_firmware = 0;
    return sim_new(&config);
}

static void run(sim_t *sim, uint64_t duration_us) {
    uint8_t bytes[BLOCK_BYTES];
    (void)sim_run(sim, duration_us, CONSOLE, false);
    printf("%llu ", (unsigned long long)sim_time_us(sim));
    size_t length = 0;
    while ((length = sim_link_read(sim, CONSOLE, bytes, sizeof bytes)) > 0) {
        for (size_t i = 0; i < length; i++) {
            printf("%02x", bytes[i]);
        }
    }
    printf("\n");
}

static void write_hex(sim_t *sim, const char *hex) {
    static uint8_t bytes[LINE_BYTES / 2];
    size_t length = 0;
    unsigned value;
    while (sscanf(hex + 2 * length, "%2x", &value) == 1) {
        bytes[length++] = (uint8_t)value;
    }
    (void)sim_link_write(sim, CONSOLE, bytes, length);
}

static void tell_pulses(void) {
    for (size_t i = 0; i < pulse_count; i++) {
        printf("%llu:%u ", (unsigned long long)pulses[i].time_us, (unsigned)pulses[i].ticks);
    }
    pulse_count = 0;
    printf("\n");
}

static void execute(sim_t *sim, char *line) {
    if (strncmp(line, "run ", 4) == 0) {
        run(sim, strtoull(line + 4, NULL, 10));
    } else if (strncmp(line, "write ", 6) == 0) {
        write_hex(sim, line + 6);
    } else if (strcmp(line, "pulses\n") == 0) {
        tell_pulses();
    } else if (strcmp(line, "light\n") == 0) {
        printf("%u\n", light_changes);
    } else if (strcmp(line, "power\n") == 0) {
        sim_power_cycle(sim);
    }
    (void)fflush(stdout);
}

int main(int count, char **arguments) {
    static char line[LINE_BYTES];
    fault = count > 1 ? (uint32_t)strtoul(arguments[1], NULL, 10) : 0;
    sim_t *sim = new_board();
    if (sim == NULL) {
        return EXIT_FAILURE;
    }
    while (fgets(line, sizeof line, stdin) != NULL) {
        execute(sim, line);
    }
    sim_free(sim);
    return EXIT_SUCCESS;
}
