/* Faults of the fish's board. */
#include "faults.h"

#include "board.h"
#include "registers/pwm.h"

#define TAIL_CHANNEL 4u
#define FAST_FRAME_TICKS 58800u /* 2 % short */

/* In flash, where a test writes another number; as an assembler's constant, so that the compiler
 * neither knows the value nor puts it into RAM. */
__asm__(".section .rodata.planted_fault_number, \"a\"\n"
        ".balign 4\n"
        ".global planted_fault_number\n"
        ".type planted_fault_number, %object\n"
        "planted_fault_number: .word 0\n"
        ".text");
extern const uint32_t planted_fault_number;

uint32_t planted_fault(void) { return planted_fault_number; }

void __real_servo_init(hal_t *hal);
void __wrap_servo_init(hal_t *hal);

void __wrap_servo_init(hal_t *hal) {
    __real_servo_init(hal);
    if (planted_fault() == FAULT_TICK_FAST) {
        PWM->CHANNEL[TAIL_CHANNEL].CPRDUPD = FAST_FRAME_TICKS;
    }
}
