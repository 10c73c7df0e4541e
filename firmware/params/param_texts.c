#include "params/params.h"

#include "base/panic.h"

typedef struct {
    const char *unit;
    const char *text;
} words_t;

static const words_t words[PARAM_COUNT] = {
#define PARAM(name, fallback, low, high, kind, unit, text) [PARAM_##name] = {unit, text},
#include "params/params.def"
#undef PARAM
};

const char *param_unit(param_t param) {
    REQUIRE((uint32_t)param < PARAM_COUNT);
    return words[param].unit;
}

const char *param_text(param_t param) {
    REQUIRE((uint32_t)param < PARAM_COUNT);
    return words[param].text;
}
