/*
 * Faults of a board, planted between it and the suite by the linker's --wrap. One program has them
 * all; planted_fault() says which of them is in effect. tests/conformance/CMakeLists.txt lists the
 * functions that are wrapped.
 */
#ifndef CONFORMANCE_FAULTS_H
#define CONFORMANCE_FAULTS_H

#include <stdint.h>

/* The numbers are those of conformance/faults.py. */
typedef enum {
    FAULT_NONE = 0,
    FAULT_FLASH_LOSES_BIT = 1,
    FAULT_FLASH_READS_OUTSIDE = 2,
    FAULT_FLASH_WRITES_MISALIGNED = 3,
    FAULT_OVERRUNS_NOT_COUNTED = 4,
    FAULT_SERIAL_WRITES_PART = 5,
    FAULT_SERIAL_LOSES_BYTE = 6,
    FAULT_BAUD_ACCEPTED = 7,
    FAULT_WATCHDOG_NEVER_BITES = 8,
    FAULT_CRASH_RECORD_LOST = 9,
    FAULT_CRASH_RECORD_STAYS = 10,
    FAULT_PULSES_GO_ON = 11,
    FAULT_CLOCK_SLOW = 12,
    FAULT_CLOCK_GOES_BACK = 13,
    FAULT_LOCK_OPEN = 14,
    FAULT_TICK_DOUBLED = 15,
    FAULT_TICK_FAST = 16,
    FAULT_RESET_CAUSE_WRONG = 17,
    FAULT_ID_CHANGES = 18,
    FAULT_BATTERY_UNSTEADY = 19,
    FAULT_SERIAL_SENDS_REFUSED = 20
} fault_t;

uint32_t planted_fault(void);

#endif
