/*
 * What can be written before the tail moves: room for the log, a step per pass while the board is
 * armed, blank blocks on a flash that erases first, and the first amplitudes if they are a guess.
 * Main loop only.
 */
#ifndef TRIAL_PREPARATION_H
#define TRIAL_PREPARATION_H

#include "learn/learner.h"
#include "trial/trial_run.h"

typedef struct {
    learner_t *learner;
    const trial_run_t *run;
    bool space_made;                /* free, but perhaps not blank yet */
    bool room_made;                 /* for the log of the trial that the board is armed for */
    bool guess_tried, guess_stored; /* its first amplitudes, if they are a guess */
} preparation_t;

/* A zeroed |preparation|; the others outlive it. */
void preparation_init(preparation_t *preparation, learner_t *learner, const trial_run_t *run);

/* The board has just been armed. */
void preparation_begin(preparation_t *preparation);

/* One step of what is left. What fails here fails at the start too, and is reported then. */
void preparation_step(preparation_t *preparation);

/* All that is left of the room; FAULT_WRITE_FAILED when there is none. Once more at the start:
 * uploads may have taken the room that was made. */
fault_t preparation_make_room(preparation_t *preparation);

/* The last blocks that must be blank before the tail moves, a few only: FAULT_ERASING when there
 * are more, which the steps to come erase. Once more when all has been written. */
fault_t preparation_erase(preparation_t *preparation);

/* A save that fails goes back to what is stored; the board stays armed and needs its guess. */
fault_t preparation_save_guess(preparation_t *preparation);

#endif
