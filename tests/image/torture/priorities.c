/* Nesting, order, tail-chaining, sub-priorities, pending and clearing. */
#include "torture.h"

static void report(const char *what) {
    say(what);
    say_hex(" IPSR", ipsr());
    say_hex(" ICSR", ICSR & 0x00C00FFFu);
    say_hex(" IABR", IABR);
}

static void plain(frame_t *frame, uint32_t exc_return) {
    (void)frame;
    report("handler");
    say_hex(" LR", exc_return);
}

static void pends_next(frame_t *frame, uint32_t exc_return) {
    (void)frame;
    const uint32_t irq = ipsr() - IRQ0;
    report("before pending the next");
    pend(irq + 1u);
    report("after pending the next");
    say_hex(" ISPR", ISPR);
    say_hex(" LR", exc_return);
}

static void pends_two(frame_t *frame, uint32_t exc_return) {
    (void)frame;
    (void)exc_return;
    ISPR = 3u << 4;
    barrier();
    report("pended 4 and 5");
}

static void nest(uint8_t first, uint8_t second, uint8_t third) {
    priority(IRQ0, first);
    priority(IRQ0 + 1, second);
    priority(IRQ0 + 2, third);
    handlers[IRQ0] = handlers[IRQ0 + 1] = pends_next;
    handlers[IRQ0 + 2] = plain;
    pend(0);
    report("thread");
}

static void pending_and_clearing(void) {
    say("pend while off");
    ICER = 1u << 8;
    pend(8);
    say_hex(" ISPR", ISPR);
    say_hex(" ICSR", ICSR & 0x0043FFFFu);
    ISER = 1u << 8;
    barrier();
    say_hex(" ISPR", ISPR);
    say("pend and clear");
    ICER = 1u << 8;
    pend(8);
    ICPR = 1u << 8;
    ISER = 1u << 8;
    barrier();
    say_hex(" ISPR", ISPR);
    say_hex(" ISER", ISER & 0xFFFu);
    say("software trigger");
    STIR = 8;
    barrier();
}

static void itself(frame_t *frame, uint32_t exc_return) {
    static uint32_t times;
    (void)frame;
    say_hex("again LR", exc_return);
    if (times++ < 3u) {
        pend(9);
        say_hex(" ISPR", ISPR);
    }
}

static void raised_meanwhile(frame_t *frame, uint32_t exc_return) {
    (void)frame;
    (void)exc_return;
    report("lowers itself below 11");
    pend(11);
    priority(IRQ0 + 10, 0xE0);
    barrier();
    report("after");
}

void test_priorities(void) {
    for (uint32_t i = 0; i < 12; i++) {
        handlers[IRQ0 + i] = plain;
    }
    ISER = 0xFFFu;
    nest(0xC0, 0x80, 0x40);
    nest(0x40, 0x80, 0xC0);
    nest(0x80, 0x80, 0x80);
    say("sub-priorities");
    group(5);
    nest(0xC0, 0xD0, 0x40);
    nest(0xF0, 0xC0, 0x80);
    group(7);
    nest(0xC0, 0x80, 0x40);
    group(0);
    say("two at once, the more urgent first");
    handlers[IRQ0 + 3] = pends_two;
    priority(IRQ0 + 3, 0x20);
    priority(IRQ0 + 4, 0x60);
    priority(IRQ0 + 5, 0x30);
    pend(3);
    pending_and_clearing();
    handlers[IRQ0 + 9] = itself;
    pend(9);
    priority(IRQ0 + 10, 0x40);
    priority(IRQ0 + 11, 0x80);
    handlers[IRQ0 + 10] = raised_meanwhile;
    pend(10);
}
