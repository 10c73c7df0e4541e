/*
 * What host/tailbeat/thesis binds, in float (libtailbeat_thesis32) and double (64). number_t is the
 * law's; the plants compute in double in both.
 */
#ifndef THESIS_BINDINGS_H
#define THESIS_BINDINGS_H

#include "advection_plant.h"
#include "chapter4.h"
#include "chapter5.h"
#include "feedback.h"
#include "learner.h"
#include "whole_trial.h"

/* Size of a bound struct as the C compiler laid it out; rows end with a NULL name. */
typedef struct {
    const char *name;
    size_t size_bytes;
} native_layout_t;

const native_layout_t *native_layout(void);

#endif
