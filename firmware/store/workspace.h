/*
 * RAM for the biggest thing that the main loop works with at the moment, whichever that is: a file
 * that has been uploaded, a past trial, the estimate of an open run, what the salvage reads.
 *
 * One at a time: who needs it takes it, and gives it back. Taking what is lent, and giving back
 * what one has not taken, is a mistake of the program: an assertion that stops the board. So nobody
 * can write over what another still reads. Main loop only.
 */
#ifndef STORE_WORKSPACE_H
#define STORE_WORKSPACE_H

#include "speed/estimate.h"
#include "store/records.h"

typedef enum {
    WORKSPACE_FREE = 0,
    WORKSPACE_SALVAGE,  /* during boot */
    WORKSPACE_UPLOAD,   /* while a file of /in becomes what it is meant to be: in IDLE */
    WORKSPACE_PAST,     /* while the law looks back: in LEARNING */
    WORKSPACE_ESTIMATE, /* from a trial's start to its end */
} workspace_user_t;

typedef union {
    reference_t reference;
    amplitudes_upload_t amplitudes;
    speed_upload_t speeds;
    memory_t memory;
    past_t past;
    trial_record_t trial;
    estimate_t estimate;
} workspace_content_t;

/* Zero-initialised = free. */
typedef struct {
    workspace_content_t content; /* of the user alone */
    workspace_user_t user;
} workspace_t;

/* |user| is not WORKSPACE_FREE, and the workspace is free. What is in it is left over from the user
 * before. */
workspace_content_t *workspace_take(workspace_t *workspace, workspace_user_t user);

/* |user| has taken it. */
void workspace_give_back(workspace_t *workspace, workspace_user_t user);

#endif
