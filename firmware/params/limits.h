/*
 * The parameters that protect fish and tank, and which of two values protects more.
 *
 * When nobody can tell which of two values is the newer one, the more restrictive of the two is
 * safe. Pure functions; cost: one pass over LIMIT_COUNT values.
 */
#ifndef PARAMS_LIMITS_H
#define PARAMS_LIMITS_H

#include "params/params.h"

#define LIMIT_COUNT 16u

/* The limits of |params|, in the order of the table in limits.c. */
void limits_get(const params_t *params, float limits[LIMIT_COUNT]);

/* Each limit of |params| that is less restrictive than that of |limits| takes its value. A value
 * that the parameter does not allow is ignored. */
void limits_restrict(params_t *params, const float limits[LIMIT_COUNT]);

#endif
