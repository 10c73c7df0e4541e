#include "guard.h"

#include "hal/guard.h"

#include "memory_map.h"
#include "registers/cortex_m3.h"

#include <string.h>

/* Regions; of two that hold an address the higher number counts. The lower ones are the chip's. */
#define REGION_STACK_END 6u
#define REGION_GUARDED 7u

#define NORMAL_MEMORY (MPU_RASR_ENABLE | MPU_RASR_XN | MPU_RASR_S | MPU_RASR_C)
#define OF_BYTES(bytes) FIELD(MPU_RASR_SIZE, __builtin_ctz(bytes) - 1)

static void allow(uint32_t access) {
    MPU->RBAR = (uint32_t)__guarded | MPU_RBAR_VALID | REGION_GUARDED;
    MPU->RASR = NORMAL_MEMORY | access | OF_BYTES(HAL_GUARDED_BYTES);
    cpu_barrier();
}

/* Below the stack lies other RAM, mirrored or in use: an overflow would go unnoticed. The access
 * field of its end stays 0, which is no access at all; but for the two regions everything is as
 * without an MPU. */
void guard_init(void) {
    memset(__guarded, 0, HAL_GUARDED_BYTES);
    const size_t bytes = (uintptr_t)__stack_bottom - (uintptr_t)__stack_guard;
    MPU->RBAR = (uint32_t)__stack_guard | MPU_RBAR_VALID | REGION_STACK_END;
    MPU->RASR = MPU_RASR_ENABLE | MPU_RASR_XN | OF_BYTES(bytes);
    MPU->CTRL = MPU_CTRL_ENABLE | MPU_CTRL_PRIVDEFENA;
    allow(MPU_RASR_AP_READ_ONLY);
}

void *hal_guarded(hal_t *hal) {
    (void)hal;
    return __guarded;
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
