/* Shared by the files of this folder only. */
#ifndef APP_APP_INTERNAL_H
#define APP_APP_INTERNAL_H

#include "app/app.h"
#include "store/critical.h"

#define CRASH_PATH "/crash.bin"

#define PAST_PATH "/past0.bin" /* to "/past7.bin" */
#define PAST_FILES 8u
#define PAST_ROOM_BYTES (3u * STORE_BLOCK_BYTES) /* of the longest, which is written anew */

/* salvage.c: mounts the store. When the filesystem or single files are unreadable, what can be
 * saved of parameters, key, reference, learned input and pending trial is brought back and told;
 * |*fault| says so, and the trials' numbers go on. A key that is seen but cannot be brought back
 * locks the board. */
store_result_t salvage_mount(app_t *app, fault_t *fault);

/* app.c: what the link tells follows the board's state of this moment. */
void app_refresh_status(app_t *app);
/* At the pack, as the divider's parameters say. */
battery_voltage_t app_battery(const app_t *app);
/* Whether |fault| is FAULT_WRITE_FAILED because the flash does not take data: that is a fault of
 * the board, which is raised and answered instead. A full store is not. */
fault_t app_judge_write(app_t *app, fault_t fault);
/* The main loop is alive; but without the tick the watchdog shall bite all the same. */
void app_feed_watchdog(app_t *app);

/* boot.c: what is on the store into RAM; parameters fall back to their defaults. */
void boot_load(app_t *app);
/* Bytes read from |path| into app->record; 0 when the file is missing, empty or too long for it. */
size_t boot_load_record(app_t *app, const char *path);
void boot_load_params(app_t *app);
/* Tells the board what the parameters say of it; false when it cannot do it. */
bool boot_apply_params(app_t *app);
/* Whether the run before this one crashed; the record goes to /crash.bin, and is kept in RAM as
 * long as it cannot be stored. */
bool boot_keep_crash(app_t *app);
/* The learned input as it was last stored; empty when it belongs to another reference. Without a
 * reference it is kept: the reference it belongs to may come back. */
void boot_load_memory(app_t *app);

/* commands.c: the link's handlers. */
fault_t commands_run(void *context, const link_command_t *command);
fault_t commands_param_set(void *context, param_t param, float value);

/* key.c: the signing key and its mark, kept in KEY_PATH. Loading reserves the next ten minutes; it
 * is false when there is a key that cannot be read, or a store that does not tell. */
bool key_load(app_t *app);
/* The link's handler. Refused unless the tail is off, disarmed and no trial is open. */
fault_t key_set(void *context, const uint8_t *key, uint64_t time);
/* Reserves at least |ahead_s| beyond the clock, for a swim that must not write. */
fault_t key_reserve(app_t *app, float ahead_s);
/* What signing_wants_mark() asks for, while no trial is open. */
void key_poll(app_t *app);
/* Zeroes whatever in |bytes| is a piece of the key: they are going where everybody may read. */
void key_hide(const app_t *app, uint8_t *bytes, size_t length);

/* uploads.c: an uploaded file becomes what it is meant to be. */
fault_t uploads_commit(app_t *app, const link_command_t *command);
/* Whether the board's limits of the moment allow |reference|. */
fault_t uploads_judge_reference(const app_t *app, const reference_t *reference);

/* swim.c: a trial from arming to the pending record.
 *
 * Hosts are told apart by port and system. Only the one that armed starts, and only its heartbeats
 * keep the board armed and the tail swimming; anybody may abort and disarm. Arming again while
 * ARMED hands the fish over to the host that asks, which is told on both ports; RUNNING refuses it.
 */
fault_t swim_arm(app_t *app, const link_command_t *command);
fault_t swim_start(app_t *app, const link_command_t *command);
void swim_stop(app_t *app, fault_t reason);
void swim_poll(app_t *app, uint64_t now_us);
/* How long the fish has been still, by the IMU. */
float swim_still_s(const app_t *app);
/* Ends the collecting of a stopped run at once. False when the trial could not be stored. */
bool swim_finish(app_t *app, uint64_t now_us);

/* learn.c: from the pending trial to the next amplitudes. */
fault_t learn_trial(app_t *app, uint32_t trial);
fault_t learn_discard(app_t *app, uint32_t trial);
fault_t learn_restore_best(app_t *app);
/* Stores the memory; when that fails RAM goes back to what is stored. */
fault_t learn_save(app_t *app);

/* past.c: earlier trials, for the laws that average. */

/* What an average has to look back on. */
typedef struct {
    past_kind_t kind;
    law_weights_t now;   /* of the trial that is learned from; not of PAST_LAST */
    uint32_t newest_crc; /* of the newest record; 0 = the average begins */
    uint16_t trials;     /* in the average so far */
    bool shortened;      /* earlier trials are missing: lost, damaged, dropped, or learned from
                            with another law */
} past_view_t;

/* Adds the weighted earlier trials to zeros in app->scratch. Uses app->record, app->shared and
 * app->measured; app->shared and |view| are past_keep's. LAW_BAD_INPUT as law_add, or when a file
 * was read well only once. */
law_result_t past_look_back(app_t *app, const law_t *law, past_view_t *view);

/* Stores what the next one needs of the pending trial, which has been learned from, ahead of
 * learn_save. |errors| are those it was learned with. */
fault_t past_keep(app_t *app, const law_t *law, const law_trial_t *errors, const past_view_t *view);

/* What past_keep asks of the store beyond its reserve. */
uint32_t past_room_bytes(const app_t *app);

/* How many earlier trials the law of the moment reads: files that are worth keeping. */
uint16_t past_reach(const app_t *app);

/* Removes the oldest file but for the places of the |keep| newest; false when there was none. The
 * chain is the newest part of what there is, so that this shortens an average and never cuts it in
 * the middle. */
bool past_drop(app_t *app, uint16_t keep);

#endif
