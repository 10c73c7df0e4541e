#include "guard.h"

#include "hal/guard.h"

#include "registers.h"
#include "registers/cortex_m3.h"

/* Of two regions that hold an address the higher number counts: this one lies in that of the DDR.
 */
#define REGION_GUARDED 2u
#define OF_ITS_BYTES FIELD(MPU_RASR_SIZE, __builtin_ctz(HAL_GUARDED_BYTES) - 1)

static uint8_t guarded[HAL_GUARDED_BYTES] __attribute__((aligned(HAL_GUARDED_BYTES)));

static void allow(uint32_t access) {
    MPU->RBAR = (uint32_t)guarded | MPU_RBAR_VALID | REGION_GUARDED;
    MPU->RASR = MPU_RASR_ENABLE | MPU_RASR_XN | MPU_RASR_CACHED | access | OF_ITS_BYTES;
    cpu_barrier();
}

void guard_init(void) { allow(MPU_RASR_AP_READ_ONLY); }

void *hal_guarded(hal_t *hal) {
    (void)hal;
    return guarded;
}

void hal_guard_open_isr(hal_t *hal) {
    (void)hal;
    cpu_interrupts_off();
    allow(MPU_RASR_AP_PRIVILEGED);
}

void hal_guard_close_isr(hal_t *hal) {
    (void)hal;
    allow(MPU_RASR_AP_READ_ONLY);
    cpu_interrupts_on();
}
