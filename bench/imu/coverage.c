/* Swims whose speed only the IMU knows: one line per beat, seed,beat,true,measured,sigma in m/s;
 * the first line names the level.
 *
 * Usage: imu_coverage tank|reactive LEVEL FIRST_SEED SWIMS; with TAILBEAT_RECORDINGS and the level
 * after the last one the noise is a recorded sensor's. */
#include "held_swims.h"

static void list(sim_plant_t plant, uint64_t first, unsigned count, const level_t *level) {
    static swim_t swim;
    for (uint64_t seed = first; seed < first + count; seed++) {
        swim_once(&swim, seed, plant, level);
        for (unsigned k = 0; k < BEATS; k++) {
            printf("%llu,%u,%.9g,%.9g,%.9g\n", (unsigned long long)seed, k, swim.true_m_s[k],
                   (double)swim.beat[k].speed_m_s, (double)swim.beat[k].sigma_m_s);
        }
    }
}

int main(int argc, char **argv) {
    const unsigned long level = argc == 5 ? strtoul(argv[2], NULL, 10) : LEVELS + 1u;
    if (level > LEVELS || (level == LEVELS && !load_noise())) {
        fprintf(stderr, "usage: imu_coverage tank|reactive LEVEL FIRST_SEED SWIMS\n");
        return 1;
    }
    const level_t *chosen = level < LEVELS ? &levels[level] : &recorded_stress;
    printf("%s\n", chosen->name);
    const sim_plant_t plant =
        strcmp(argv[1], "reactive") == 0 ? SIM_PLANT_REACTIVE : SIM_PLANT_TANK;
    list(plant, strtoull(argv[3], NULL, 10), (unsigned)strtoul(argv[4], NULL, 10), chosen);
    return 0;
}
