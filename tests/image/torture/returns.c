/* Returns that are not allowed; with vectors in RAM. */
#include "torture.h"

static uint32_t vectors_in_ram[EXCEPTIONS] __attribute__((aligned(256)));

static void vector(uint32_t number, void (*handler)(void)) {
    vectors_in_ram[number] = (uint32_t)(uintptr_t)handler;
    barrier();
}

/* 0xFFFFFFF5 is no EXC_RETURN. */
__attribute__((naked)) static void returns_badly(void) { __asm volatile("mvn r0, #10\n bx r0"); }

/* To handler mode, where there is none to return to. */
__attribute__((naked)) static void returns_to_no_handler(void) {
    __asm volatile("mvn r0, #14\n bx r0");
}

__attribute__((used)) static void report(frame_t *frame, uint32_t exc_return) {
    say_hex("CFSR", CFSR);
    say_hex(" LR", exc_return);
    say_hex(" SHCSR", SHCSR);
    say_hex(" in frame", frame->xpsr & 0x010001FFu);
    frame->xpsr = 1u << 24;
    CFSR = 0xFFFFFFFFu;
}

/* Whatever it came with, it goes back to the thread. */
__attribute__((naked)) static void repairs(void) {
    __asm volatile("mov r0, sp\n"
                   "mov r1, lr\n"
                   "push {r4, lr}\n"
                   "bl report\n"
                   "pop {r4, lr}\n"
                   "mvn r0, #6\n"
                   "bx r0");
}

static void forges_frame(frame_t *frame, uint32_t exc_return) {
    (void)exc_return;
    frame->xpsr |= 11u;
}

static void svc(void) { __asm volatile("svc 0" ::: "r0", "r1", "r2", "r3", "r12", "memory"); }

void test_returns(void) {
    const uint32_t *flash = (const uint32_t *)(uintptr_t)VTOR;
    for (uint32_t i = 0; i < EXCEPTIONS; i++) {
        vectors_in_ram[i] = flash[i];
    }
    VTOR = (uint32_t)(uintptr_t)vectors_in_ram;
    SHCSR |= FAULTS_ENABLED;
    say("bad EXC_RETURN");
    vector(USAGE, repairs);
    vector(SVC, returns_badly);
    svc();
    say("to a handler that is not there");
    vector(SVC, returns_to_no_handler);
    svc();
    say("forged frame");
    vector(SVC, (void (*)(void))(uintptr_t)flash[SVC]);
    handlers[SVC] = forges_frame;
    svc();
    SHCSR &= ~FAULTS_ENABLED;
    VTOR = (uint32_t)(uintptr_t)flash;
}
