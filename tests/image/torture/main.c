/*
 * Exceptions of a Cortex-M3 by the book, as a log to compare: the same image runs in QEMU and in
 * vboard, and both must say the same. Only the top four bits of a priority are used.
 */
#include "torture.h"

#define LOG_BYTES 32768u
#define SEMIHOSTING_WRITE0 4u
#define SEMIHOSTING_EXIT 0x18u
#define EXIT_OK 0x20026u

extern uint32_t stack_top, bss_start, bss_end;
handler_t handlers[EXCEPTIONS];
static char text_log[LOG_BYTES];
static uint32_t used;

static void semihosting(uint32_t operation, uintptr_t argument) {
    register uint32_t r0 __asm("r0") = operation;
    register uintptr_t r1 __asm("r1") = argument;
    __asm volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
}

static void finish(void) {
    text_log[used] = 0;
    semihosting(SEMIHOSTING_WRITE0, (uintptr_t)text_log);
    semihosting(SEMIHOSTING_EXIT, EXIT_OK);
    for (;;) {
    }
}

static void put(char c) {
    if (used < LOG_BYTES - 1u) {
        text_log[used++] = c;
    }
}

static void put_text(const char *text) {
    while (*text != 0) {
        put(*text++);
    }
}

void say(const char *text) {
    put_text(text);
    put('\n');
}

void say_hex(const char *name, uint32_t value) {
    put_text(name);
    put(' ');
    for (int shift = 28; shift >= 0; shift -= 4) {
        put("0123456789abcdef"[value >> shift & 15u]);
    }
    put('\n');
}

void skip_instruction(frame_t *frame) {
    const uint16_t opcode = *(const uint16_t *)(uintptr_t)frame->pc;
    frame->pc += opcode >> 11 >= 0x1Du ? 4u : 2u;
}

__attribute__((used)) void on_exception(frame_t *frame, uint32_t exc_return) {
    const uint32_t number = ipsr();
    if (number >= EXCEPTIONS || handlers[number] == 0) {
        say_hex("unexpected exception", number);
        say_hex("CFSR", CFSR);
        say_hex("HFSR", HFSR);
        finish();
    }
    handlers[number](frame, exc_return);
}

__attribute__((naked)) static void entry(void) {
    __asm volatile("tst lr, #4\n"
                   "ite eq\n"
                   "mrseq r0, msp\n"
                   "mrsne r0, psp\n"
                   "mov r1, lr\n"
                   "b on_exception\n");
}

static void run(const char *name, void (*part)(void)) {
    put_text("== ");
    say(name);
    for (uint32_t i = 0; i < EXCEPTIONS; i++) {
        handlers[i] = 0;
        if (i >= MEM && i != 7 && i != 8 && i != 9 && i != 10 && i != 13) {
            priority(i, 0);
        }
    }
    ICER = 0xFFFFFFFFu;
    ICPR = 0xFFFFFFFFu;
    group(0);
    part();
}

__attribute__((used)) void reset_handler(void) {
    for (uint32_t *word = &bss_start; word < &bss_end; word++) {
        *word = 0;
    }
    VTOR = 0x80000u;
    run("priorities", test_priorities);
    run("masks", test_masks);
    run("calls", test_calls);
    run("stacks", test_stacks);
    run("returns", test_returns);
    run("faults", test_faults);
    run("protection", test_protection);
    run("systick", test_systick);
    finish();
}

#define ENTRY4 entry, entry, entry, entry
#define ENTRY16 ENTRY4, ENTRY4, ENTRY4, ENTRY4
__attribute__((section(".vectors"), used)) static void (*const vectors[])(void) = {
    (void (*)(void))(uintptr_t)&stack_top,
    reset_handler,
    entry,
    entry,
    ENTRY4,
    ENTRY4,
    ENTRY4,
    ENTRY16,
    ENTRY16,
};
