/* What the torture programs share: registers, the log, the handlers of the moment. */
#ifndef TORTURE_H
#define TORTURE_H

#include <stdbool.h>
#include <stdint.h>

#define REG(address) (*(volatile uint32_t *)(uintptr_t)(address))
#define ICSR REG(0xE000ED04u)
#define VTOR REG(0xE000ED08u)
#define AIRCR REG(0xE000ED0Cu)
#define SCR REG(0xE000ED10u)
#define CCR REG(0xE000ED14u)
#define SHPR(n) (*(volatile uint8_t *)(uintptr_t)(0xE000ED18u + (n)-4u))
#define SHCSR REG(0xE000ED24u)
#define CFSR REG(0xE000ED28u)
#define HFSR REG(0xE000ED2Cu)
#define MMFAR REG(0xE000ED34u)
#define BFAR REG(0xE000ED38u)
#define STIR REG(0xE000EF00u)
#define SYST_CTRL REG(0xE000E010u)
#define SYST_LOAD REG(0xE000E014u)
#define SYST_VAL REG(0xE000E018u)
#define ISER REG(0xE000E100u)
#define ICER REG(0xE000E180u)
#define ISPR REG(0xE000E200u)
#define ICPR REG(0xE000E280u)
#define IABR REG(0xE000E300u)
#define IPR(n) (*(volatile uint8_t *)(uintptr_t)(0xE000E400u + (n)))
#define MPU_CTRL REG(0xE000ED94u)
#define MPU_RNR REG(0xE000ED98u)
#define MPU_RBAR REG(0xE000ED9Cu)
#define MPU_RASR REG(0xE000EDA0u)

#define PENDSVSET (1u << 28)
#define PENDSVCLR (1u << 27)
#define PENDSTSET (1u << 26)
#define PENDSTCLR (1u << 25)
#define NMIPENDSET (1u << 31)
#define FAULTS_ENABLED 0x70000u

enum { NMI = 2, HARD = 3, MEM = 4, BUS = 5, USAGE = 6, SVC = 11, PENDSV = 14, SYSTICK = 15 };
enum { IRQ0 = 16, EXCEPTIONS = 48 };

/* The eight words that the processor stacked. */
typedef struct {
    uint32_t r0, r1, r2, r3, r12, lr, pc, xpsr;
} frame_t;

typedef void (*handler_t)(frame_t *frame, uint32_t exc_return);

/* By exception number; cleared before each part. */
extern handler_t handlers[EXCEPTIONS];
/* For a handler to go on behind the present instruction. */
void skip_instruction(frame_t *frame);

void say(const char *text);
void say_hex(const char *name, uint32_t value);

static inline void barrier(void) { __asm volatile("dsb\n isb" ::: "memory"); }
static inline void pend(uint32_t irq) {
    ISPR = 1u << irq;
    barrier();
}
static inline void priority(uint32_t number, uint8_t value) {
    if (number < IRQ0) {
        SHPR(number) = value;
    } else {
        IPR(number - IRQ0) = value;
    }
}
static inline void group(uint32_t bits) { AIRCR = 0x05FA0000u | bits << 8; }
static inline uint32_t ipsr(void) {
    uint32_t value;
    __asm volatile("mrs %0, ipsr" : "=r"(value));
    return value;
}

void test_priorities(void);
void test_masks(void);
void test_calls(void);
void test_stacks(void);
void test_returns(void);
void test_faults(void);
void test_protection(void);
void test_systick(void);

#endif
