/* Swims whose speed only the IMU knows: one line per beat, seed,beat,true,measured,sigma in m/s;
 * the first line names the level.
 *
 * Usage: imu_coverage LEVEL FIRST_SEED SWIMS; with TAILBEAT_RECORDINGS and the level after the last
 * one the noise is a recorded sensor's. */
#include "held_swims.h"

static void list(uint64_t first, unsigned count, const level_t *level) {
    static swim_t swim;
    for (uint64_t seed = first; seed < first + count; seed++) {
        swim_once(&swim, seed, level);
        for (unsigned k = 0; k < BEATS; k++) {
            printf("%llu,%u,%.9g,%.9g,%.9g\n", (unsigned long long)seed, k, swim.true_m_s[k],
                   (double)swim.beat[k].speed_m_s, (double)swim.beat[k].sigma_m_s);
        }
    }
}

int main(int argc, char **argv) {
    const unsigned long level = argc == 4 ? strtoul(argv[1], NULL, 10) : LEVELS + 1u;
    if (level > LEVELS || (level == LEVELS && !load_noise())) {
        fprintf(stderr, "usage: imu_coverage LEVEL FIRST_SEED SWIMS\n");
        return 1;
    }
    const level_t *chosen = level < LEVELS ? &levels[level] : &recorded_stress;
    printf("%s\n", chosen->name);
    list(strtoull(argv[2], NULL, 10), (unsigned)strtoul(argv[3], NULL, 10), chosen);
    return 0;
}
