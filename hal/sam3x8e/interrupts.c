#include "interrupts.h"

#include "hal/system.h"

void hal_irq_lock(hal_t *hal) {
    (void)hal;
    cpu_set_basepri(PRIORITY_BITS(PRIORITY_TICK));
}

void hal_irq_unlock(hal_t *hal) {
    (void)hal;
    cpu_set_basepri(0);
}
