#include "ilc/number.h"

#include "ilc/number_order.h"

#ifdef ILC_DOUBLE
#include <math.h>

bool number_is_finite(number_t x) { return isfinite(x); }
number_t number_abs(number_t x) { return fabs(x); }
number_t number_sqrt(number_t x) { return x > 0.0 ? sqrt(x) : 0.0; }

#else
#include "base/real.h"

bool number_is_finite(number_t x) { return real_is_finite(x); }
number_t number_abs(number_t x) { return real_abs(x); }
number_t number_sqrt(number_t x) { return real_sqrt(x); }

#endif

number_t number_clip(number_t x, number_t low, number_t high) {
    if (number_order(x) > number_order(high)) {
        return number_is_nan(x) ? x : high;
    }
    return number_order(x) < number_order(low) && !number_is_nan(x) ? low : x;
}
