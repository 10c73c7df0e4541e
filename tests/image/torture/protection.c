/* Memory protection as a stack guard uses it. */
#include "torture.h"

#define ENABLE 1u
#define HFNMIENA 2u
#define PRIVDEFENA 4u
#define NO_ACCESS (0u << 24)
#define FULL_ACCESS (3u << 24)
#define READ_ONLY (6u << 24)
#define SIZE(log2) (((log2)-1u) << 1)

static uint32_t room[2048] __attribute__((aligned(8192)));

static void show(frame_t *frame, uint32_t exc_return) {
    (void)frame;
    say_hex("fault", ipsr());
    say_hex(" CFSR", CFSR);
    say_hex(" HFSR", HFSR);
    if ((CFSR & 0x80u) != 0) {
        say_hex(" at", MMFAR - (uint32_t)(uintptr_t)room);
    }
    say_hex(" LR", exc_return);
    CFSR = 0xFFFFFFFFu;
    HFSR = 0xFFFFFFFFu;
}

static void show_and_skip(frame_t *frame, uint32_t exc_return) {
    show(frame, exc_return);
    skip_instruction(frame);
}

static void region(uint32_t number, uint32_t offset, uint32_t attributes) {
    MPU_RNR = number;
    MPU_RBAR = (uint32_t)(uintptr_t)room + offset;
    MPU_RASR = attributes | ENABLE;
}

static void write_to(uint32_t offset) {
    __asm volatile("str %0, [%1]" ::"r"(offset), "r"((uintptr_t)room + offset) : "memory");
}

static void read_from(uint32_t offset) {
    uint32_t value = 0xEEEEu;
    __asm volatile("ldr %0, [%1]" : "+r"(value) : "r"((uintptr_t)room + offset) : "memory");
    say_hex("read", value);
}

static void around(uint32_t offset, uint32_t size) {
    write_to(offset - 4u);
    write_to(offset);
    write_to(offset + size - 4u);
    write_to(offset + size);
    read_from(offset - 4u);
    read_from(offset);
    read_from(offset + size - 4u);
    read_from(offset + size);
}

/* 1 if an IT block ends as written that loads or stores; its last instruction makes its condition
 * false, which is nothing to the code behind it. */
static uint32_t load_in_block(uint32_t offset) {
    uint32_t goes_on = 0, value;
    __asm volatile("cmp %2, %2\n"
                   "itt eq\n"
                   "ldreq %1, [%2]\n"
                   "cmpeq %2, #0\n"
                   "b 1f\n"
                   "1: mov %0, #1\n"
                   : "+r"(goes_on), "=&r"(value)
                   : "r"((uintptr_t)room + offset)
                   : "cc", "memory");
    return goes_on;
}

static uint32_t store_in_block(uint32_t offset) {
    uint32_t goes_on = 0;
    __asm volatile("cmp %1, %1\n"
                   "itt eq\n"
                   "streq %1, [%1]\n"
                   "cmpeq %1, #0\n"
                   "b 1f\n"
                   "1: mov %0, #1\n"
                   : "+r"(goes_on)
                   : "r"((uintptr_t)room + offset)
                   : "cc", "memory");
    return goes_on;
}

static void access_in_block(uint32_t offset) {
    region(0, 1024, NO_ACCESS | SIZE(5));
    barrier();
    say_hex("load", load_in_block(offset));
    region(0, 1024, READ_ONLY | SIZE(5));
    barrier();
    say_hex("store", store_in_block(offset));
}

static void only_returns(frame_t *frame, uint32_t exc_return) {
    (void)frame;
    say_hex("SVC LR", exc_return);
}

/* The frame of the SVC meets the guard: the stacking fails, MemManage comes in its place. */
static void stack_meets_guard(void) {
    __asm volatile("msr psp, %0\n"
                   "mov r4, #2\n"
                   "msr control, r4\n"
                   "isb\n"
                   "svc 0\n"
                   "mov r4, #0\n"
                   "msr control, r4\n"
                   "isb" ::"r"((uintptr_t)room + 4096u + 16u)
                   : "r4", "memory");
}

static void goes_on_elsewhere(frame_t *frame, uint32_t exc_return) {
    (void)frame;
    say_hex("stacking failed CFSR", CFSR);
    say_hex(" SHCSR", SHCSR);
    say_hex(" LR", exc_return);
    CFSR = 0xFFFFFFFFu;
    MPU_CTRL = 0;
    SHCSR &= ~(1u << 15);
    uint32_t *stack = room + 1024u;
    __asm volatile("msr psp, %0" ::"r"(stack) : "memory");
    frame_t *good = (frame_t *)(uintptr_t)stack;
    good->pc = frame->pc;
    good->xpsr = 1u << 24;
    extern void after_guard(void);
    good->pc = (uint32_t)(uintptr_t)after_guard & ~1u;
}

static uint32_t saved[10] __attribute__((used));

__attribute__((naked, noinline)) static void try_stack_guard(void) {
    __asm volatile("ldr r0, =saved\n"
                   "mov r1, sp\n"
                   "stmia r0, {r1, r4-r11, lr}\n"
                   "b meet_guard\n"
                   ".global after_guard\n"
                   ".thumb_func\n"
                   "after_guard:\n"
                   "mov r4, #0\n"
                   "msr control, r4\n"
                   "isb\n"
                   "ldr r0, =saved\n"
                   "ldmia r0, {r1, r4-r11, lr}\n"
                   "mov sp, r1\n"
                   "bx lr\n");
}

__attribute__((used)) static void meet_guard(void) { stack_meets_guard(); }

void test_protection(void) {
    handlers[HARD] = handlers[MEM] = show_and_skip;
    for (uint32_t i = 0; i < 2048u; i++) {
        room[i] = i;
    }
    barrier();
    SHCSR |= FAULTS_ENABLED;
    say("no access, 32 bytes");
    region(0, 4096, NO_ACCESS | SIZE(5));
    MPU_CTRL = ENABLE | PRIVDEFENA;
    barrier();
    around(4096, 32);
    say("read only, 256 bytes, half of it left out");
    region(0, 1024, READ_ONLY | SIZE(8) | 0xF000u);
    barrier();
    around(1024, 128);
    say("an exception in the middle, 4096 bytes");
    region(0, 0, NO_ACCESS | SIZE(12));
    region(1, 512, FULL_ACCESS | SIZE(9));
    barrier();
    around(512, 512);
    say("in an IT block: beside the region; in another page");
    region(1, 4096, FULL_ACCESS | SIZE(5));
    access_in_block(512);
    access_in_block(6144);
    say("escalated; HardFault itself passes");
    region(1, 4096, NO_ACCESS | SIZE(5));
    region(0, 4096, NO_ACCESS | SIZE(5));
    SHCSR &= ~FAULTS_ENABLED;
    write_to(4096);
    __asm volatile("cpsid f" ::: "memory");
    write_to(4096);
    read_from(4096);
    __asm volatile("cpsie f" ::: "memory");
    SHCSR |= FAULTS_ENABLED;
    say("a stack that reaches the guard");
    handlers[SVC] = only_returns;
    handlers[MEM] = goes_on_elsewhere;
    priority(SVC, 0x80);
    try_stack_guard();
    MPU_CTRL = 0;
    barrier();
    SHCSR &= ~FAULTS_ENABLED;
    write_to(4096);
    read_from(4096);
}
