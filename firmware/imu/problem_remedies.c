#include "imu/driver.h"

#include "base/panic.h"

#include <stddef.h>

static const char *const remedies[] = {
#define IMU_PROBLEM(name, number, meaning, remedy) [number] = remedy,
#include "imu/problems.def"
#undef IMU_PROBLEM
};

const char *imu_problem_remedy(imu_problem_t problem) {
    REQUIRE((size_t)problem < sizeof remedies / sizeof remedies[0]);
    return remedies[problem];
}
