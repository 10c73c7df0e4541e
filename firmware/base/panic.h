/*
 * Assertions for our own mistakes; always on. The world's faults (bad bytes, dead sensors, full
 * flash) never end here: they have result codes and counters.
 */
#ifndef BASE_PANIC_H
#define BASE_PANIC_H

/* Stops pulses, records the place and restarts the board. Each board provides it; it does not
 * return. |where| is "file:line" with static storage. */
_Noreturn void panic(const char *where);

#define PANIC_TEXT_(x) #x
#define PANIC_TEXT(x) PANIC_TEXT_(x)
#define REQUIRE(condition) ((condition) ? (void)0 : panic(__FILE__ ":" PANIC_TEXT(__LINE__)))

#endif
