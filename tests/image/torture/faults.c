/* Faults, what they record, and what becomes of them when nobody is enabled for them. */
#include "torture.h"

#define NOWHERE 0x30000000u

static const char *name_of(uint32_t number) {
    static const char *const names[] = {"HardFault", "MemManage", "BusFault", "UsageFault"};
    return number >= HARD && number <= USAGE ? names[number - HARD] : "other";
}

static void show(frame_t *frame, uint32_t exc_return) {
    say(name_of(ipsr()));
    say_hex(" CFSR", CFSR);
    say_hex(" HFSR", HFSR);
    if ((CFSR & 1u << 15) != 0) {
        say_hex(" BFAR", BFAR);
    }
    say_hex(" SHCSR", SHCSR);
    say_hex(" LR", exc_return);
    say_hex(" xpsr", frame->xpsr & 0x010001FFu);
    CFSR = 0xFFFFFFFFu;
    HFSR = 0xFFFFFFFFu;
}

static void show_and_skip(frame_t *frame, uint32_t exc_return) {
    show(frame, exc_return);
    say_hex(" opcode", *(const uint16_t *)(uintptr_t)frame->pc & 0xF800u);
    skip_instruction(frame);
}

static void show_and_return_to_caller(frame_t *frame, uint32_t exc_return) {
    show(frame, exc_return);
    frame->pc = frame->lr & ~1u;
    frame->xpsr |= 1u << 24;
}

static void load_nowhere(void) {
    uint32_t value = 0x1234;
    __asm volatile("ldr %0, [%1, #8]" : "+r"(value) : "r"(NOWHERE) : "memory");
    say_hex("register kept", value);
}

static void store_nowhere(void) {
    __asm volatile("strb %0, [%1, #3]" ::"r"(1u), "r"(NOWHERE) : "memory");
}

static void undefined(void) { __asm volatile("udf #1\n udf.w #2" ::: "memory"); }

static void coprocessor(void) { __asm volatile("mcr p11, 0, r0, c0, c0, 0" ::: "memory"); }

static void arm_state(void) {
    __asm volatile("ldr r1, =load_target\n bic r1, r1, #1\n blx r1" ::: "r1", "r0", "lr", "memory");
}

__attribute__((used, naked, aligned(4))) void load_target(void) { __asm volatile("nop\n bx lr"); }

static void jump_nowhere(void) {
    __asm volatile("orr r1, %0, #1\n blx r1" ::"r"(NOWHERE) : "r1", "lr", "memory");
}

/* The jump: QEMU 7.2 loses what registers got in the same block when a division traps. */
#define DIVIDE(instruction, quotient, dividend, divisor)                                           \
    __asm volatile("b 1f\n1: " instruction " %0, %1, %2"                                           \
                   : "+r"(quotient)                                                                \
                   : "r"(dividend), "r"(divisor))

static void divide_by_zero(void) {
    uint32_t quotient = 5;
    DIVIDE("udiv", quotient, 7u, 0u);
    say_hex("udiv", quotient);
    DIVIDE("sdiv", quotient, 7u, 0u);
    say_hex("sdiv", quotient);
}

static void divide(void) {
    uint32_t quotient = 0;
    DIVIDE("udiv", quotient, 100u, 7u);
    say_hex("udiv", quotient);
    DIVIDE("udiv", quotient, 0xFFFFFFF9u, 2u);
    say_hex("udiv", quotient);
    DIVIDE("sdiv", quotient, 0xFFFFFFF9u, 2u);
    say_hex("sdiv", quotient);
    DIVIDE("sdiv", quotient, 7u, 0xFFFFFFFEu);
    say_hex("sdiv", quotient);
    DIVIDE("sdiv", quotient, 0x80000000u, 0xFFFFFFFFu);
    say_hex("sdiv", quotient);
    __asm volatile("cmp %1, #7\n"
                   "ittet eq\n"
                   "udiveq %0, %2, %1\n"
                   "addeq %0, %0, #1\n"
                   "udivne %0, %1, %1\n"
                   "addeq %0, %0, #2"
                   : "+r"(quotient)
                   : "r"(7u), "r"(700u)
                   : "cc");
    say_hex("in an IT block", quotient);
}

static void each(void) {
    load_nowhere();
    store_nowhere();
    undefined();
    coprocessor();
    for (uint32_t i = HARD; i <= USAGE; i++) {
        handlers[i] = show_and_return_to_caller;
    }
    arm_state();
    jump_nowhere();
    for (uint32_t i = HARD; i <= USAGE; i++) {
        handlers[i] = show_and_skip;
    }
}

static void faults_inside(frame_t *frame, uint32_t exc_return) {
    (void)frame;
    (void)exc_return;
    say_hex("fault within", ipsr());
    load_nowhere();
}

static void bus_in_bus(frame_t *frame, uint32_t exc_return) {
    show_and_skip(frame, exc_return);
    say("and once more inside");
    load_nowhere();
}

static void usage_in_bus(frame_t *frame, uint32_t exc_return) {
    show_and_skip(frame, exc_return);
    say("and another inside");
    __asm volatile("udf #3");
}

void test_faults(void) {
    for (uint32_t i = HARD; i <= USAGE; i++) {
        handlers[i] = show_and_skip;
    }
    say("all escalate");
    each();
    SHCSR |= FAULTS_ENABLED;
    say("all enabled");
    each();
    say("division, trapped and not");
    CCR |= 1u << 4;
    divide_by_zero();
    divide();
    CCR &= ~(1u << 4);
    divide_by_zero();
    divide();
    say("within an interrupt, more and less urgent");
    handlers[IRQ0] = faults_inside;
    ISER = 1;
    priority(IRQ0, 0x80);
    priority(BUS, 0x40);
    pend(0);
    priority(BUS, 0xC0);
    pend(0);
    say("under PRIMASK and under BASEPRI");
    __asm volatile("cpsid i" ::: "memory");
    load_nowhere();
    __asm volatile("cpsie i" ::: "memory");
    __asm volatile("msr basepri, %0" ::"r"(0x40u) : "memory");
    load_nowhere();
    __asm volatile("msr basepri, %0" ::"r"(0u) : "memory");
    say("within a fault");
    handlers[BUS] = bus_in_bus;
    load_nowhere();
    handlers[BUS] = usage_in_bus;
    priority(BUS, 0x80);
    priority(USAGE, 0x40);
    load_nowhere();
    priority(USAGE, 0xC0);
    load_nowhere();
    SHCSR &= ~FAULTS_ENABLED;
}
