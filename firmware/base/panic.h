/*
 * Assertions for our own mistakes; always on. The world's faults (bad bytes, dead sensors, full
 * flash) never end here: they have result codes and counters.
 */
#ifndef BASE_PANIC_H
#define BASE_PANIC_H

/* Stops pulses, records the place and restarts the board. Each board provides it; it does not
 * return. |where| is "file:line" with static storage. */
_Noreturn void panic(const char *where);

/* Without its folder a place takes half the flash: 1.1 KB of the image. */
#ifdef __FILE_NAME__
#define PANIC_FILE __FILE_NAME__
#else
#define PANIC_FILE __FILE__
#endif

#define PANIC_TEXT_(x) #x
#define PANIC_TEXT(x) PANIC_TEXT_(x)
#define REQUIRE(condition) ((condition) ? (void)0 : panic(PANIC_FILE ":" PANIC_TEXT(__LINE__)))

#endif
