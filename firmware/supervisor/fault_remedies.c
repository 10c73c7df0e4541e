#include "supervisor/faults.h"

#include "base/panic.h"

static const char *const remedies[] = {
#define FAULT(number, name, kind, meaning, remedy) remedy,
#include "supervisor/faults.def"
#undef FAULT
};

const char *fault_remedy(uint16_t row) {
    REQUIRE(row < fault_count());
    return remedies[row];
}
