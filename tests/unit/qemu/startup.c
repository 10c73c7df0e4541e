/* From reset to the test's main(), and an end with an error whatever goes wrong on the way. */
#include "semihosting.h"

#include <stdint.h>
#include <stdlib.h>

#define FAULT_STATUS 99

extern uint32_t __stack_top[], __bss_start[], __bss_end[];

int main(void);

_Noreturn static void fault_isr(void) {
    static const char text[] = "the core took a fault\n";
    semihosting_write(text, sizeof text - 1u);
    semihosting_exit(FAULT_STATUS);
}

_Noreturn void reset_handler(void) {
    for (uint32_t *word = __bss_start; word < __bss_end; word++) {
        *word = 0;
    }
    exit(main());
}

/* The exceptions; no interrupt is ever enabled. */
__attribute__((section(".vectors"), used)) static const uintptr_t vectors[16] = {
    (uintptr_t)__stack_top, (uintptr_t)reset_handler, (uintptr_t)fault_isr, (uintptr_t)fault_isr,
    (uintptr_t)fault_isr,   (uintptr_t)fault_isr,     (uintptr_t)fault_isr,
};
