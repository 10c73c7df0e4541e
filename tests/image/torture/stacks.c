/* Frames on both stacks, their alignment, the processor state across an exception. */
#include "torture.h"

#define FLAGS 0xF8000000u

static uint32_t process_stack[64] __attribute__((aligned(8)));

static uint32_t control(void) {
    uint32_t value;
    __asm volatile("mrs %0, control" : "=r"(value));
    return value;
}

static void show_frame(frame_t *frame, uint32_t exc_return) {
    say_hex("LR", exc_return);
    say_hex(" aligned", (uintptr_t)frame & 7u);
    say_hex(" xpsr", frame->xpsr & ~FLAGS);
    say_hex(" CONTROL", control());
    say_hex(" r1", frame->r1);
    say_hex(" r12", frame->r12);
    frame->r2 = 0x22222222u;
}

static void aligned_and_not(void) {
    for (uint32_t bytes = 0; bytes <= 4u; bytes += 4u) {
        uint32_t lost;
        __asm volatile("mov r4, sp\n"
                       "sub sp, sp, %1\n"
                       "mov r5, sp\n"
                       "movw r1, #0x1111\n"
                       "movw r12, #0x1212\n"
                       "svc 0\n"
                       "mov %0, sp\n"
                       "sub %0, r5, %0\n"
                       "mov sp, r4"
                       : "=&r"(lost)
                       : "r"(bytes)
                       : "r1", "r2", "r4", "r5", "r12", "memory");
        say_hex("lost by the way", lost);
    }
}

static void on_process_stack(uint32_t words_off) {
    uint32_t used, r2, main_moved;
    uint32_t *top = process_stack + 62 - words_off;
    __asm volatile("mrs r5, msp\n"
                   "msr psp, %3\n"
                   "mov r4, #2\n"
                   "msr control, r4\n"
                   "isb\n"
                   "movw r1, #0x3333\n"
                   "movw r12, #0x4444\n"
                   "cmp r4, #2\n"
                   "svc 0\n"
                   "mrs %0, psp\n"
                   "mov %1, r2\n"
                   "mov r4, #0\n"
                   "msr control, r4\n"
                   "isb\n"
                   "mrs %2, msp\n"
                   "sub %2, %2, r5\n"
                   : "=&r"(used), "=&r"(r2), "=&r"(main_moved)
                   : "r"(top)
                   : "r1", "r2", "r4", "r5", "r12", "cc", "memory");
    say_hex("PSP off by", (uint32_t)(uintptr_t)top - used);
    say_hex("MSP off by", main_moved);
    say_hex("r2", r2);
}

static void inside(frame_t *frame, uint32_t exc_return) {
    (void)frame;
    say_hex("inner LR", exc_return);
}

static void nests(frame_t *frame, uint32_t exc_return) {
    say_hex("outer LR", exc_return);
    pend(1);
    frame->r2 = 0x55555555u;
}

static void flags_survive(void) {
    uint32_t flags;
    __asm volatile("movs r0, #0\n"
                   "subs r0, #1\n"
                   "svc 0\n"
                   "mrs %0, apsr\n"
                   : "=r"(flags)::"r0", "r1", "r2", "cc", "memory");
    say_hex("flags", flags & FLAGS);
    __asm volatile("mvn r0, #0x80000000\n"
                   "adds r0, r0, r0\n"
                   "svc 0\n"
                   "mrs %0, apsr\n"
                   : "=r"(flags)::"r0", "r1", "r2", "cc", "memory");
    say_hex("flags", flags & FLAGS);
}

static void ends_in_it_block(void) {
    uint32_t result;
    __asm volatile("movs %0, #1\n"
                   "cmp %0, #1\n"
                   "itttt eq\n"
                   "addeq %0, #0x10\n"
                   "svceq 0\n"
                   "addeq %0, #0x20\n"
                   "addeq %0, #0x40\n"
                   : "=&l"(result)::"r1", "r2", "r3", "r12", "cc", "memory");
    say_hex("IT block", result);
}

void test_stacks(void) {
    handlers[SVC] = show_frame;
    aligned_and_not();
    on_process_stack(0);
    on_process_stack(1);
    flags_survive();
    ends_in_it_block();
    handlers[SVC] = nests;
    handlers[IRQ0 + 1] = inside;
    priority(SVC, 0x80);
    priority(IRQ0 + 1, 0x40);
    ISER = 2;
    on_process_stack(0);
}
