#include "supervisor/faults.h"

#include "base/panic.h"

static const fault_info_t ROWS[] = {
#define FAULT(number, name, kind, meaning, remedy) {number, FAULT_KIND_##kind, #name, meaning},
#include "supervisor/faults.def"
#undef FAULT
};

uint16_t fault_count(void) { return (uint16_t)(sizeof ROWS / sizeof ROWS[0]); }

const fault_info_t *fault_row(uint16_t row) {
    REQUIRE(row < fault_count());
    return &ROWS[row];
}

const fault_info_t *fault_info(fault_t fault) {
    for (uint16_t row = 0; row < fault_count(); row++) {
        if (ROWS[row].number == (uint32_t)fault) {
            return &ROWS[row];
        }
    }
    return &ROWS[0];
}
