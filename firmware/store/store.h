/*
 * Files on the board: littlefs over the storage flash.
 *
 * Owns the mounted filesystem and all its buffers. One instance per board, no heap. Every replace
 * is one commit: after a cut at any instant the old or the new content is there. Main loop only; a
 * call that writes may take up to 100 ms on hardware.
 */
#ifndef STORE_STORE_H
#define STORE_STORE_H

#include "store/store_call.h"
#include "store/store_file.h"
#include "store/store_types.h"

/* STORE_OK when a store can be made of |hal|'s flash, else STORE_TOO_SMALL or STORE_BAD_GEOMETRY.
 */
store_result_t store_fits(const hal_t *hal);

/* Mounting, in steps, for a caller who wants to save what lies in the blocks before they are used
 * anew. |store| must not move while mounted. Every other call answers STORE_IO while not mounted.
 *
 * store_find mounts the filesystem that is there, once store_fits. STORE_CORRUPT: there is none,
 * one that lacks a folder (littlefs mounts only when every folder is readable), or one whose making
 * a cut ended.
 *
 * store_renew makes an empty one and mounts it. Blocks whose bit (b % 8 of byte b / 8) is set in
 * |keep| (NULL: none; 0 and 1 cannot be kept) are not written before store_finish: until then the
 * filesystem counts as unfinished, and whoever finds it after a cut may save them again.
 *
 * store_finish makes /trials and /in and removes what a cut left behind: halves of a store_replace
 * and trial files without content; where littlefs cannot see which blocks are free, also the files
 * whose blocks it cannot find. A flash that is full or cannot be written stays mounted, so that
 * the trials on it can be read. */
store_result_t store_find(store_t *store, hal_t *hal);
store_result_t store_renew(store_t *store, hal_t *hal, const uint8_t *keep);
store_result_t store_finish(store_t *store);

/* All of it; saves nothing. */
store_result_t store_mount(store_t *store, hal_t *hal);

/* Erases all files and mounts the empty filesystem. */
store_result_t store_format(store_t *store, hal_t *hal);

/* All files must be closed. */
void store_unmount(store_t *store);

/* Replaces |path| with the given bytes, atomically. */
store_result_t store_replace(store_t *store, const char *path, const void *bytes, size_t length);

/* The same with a generation, which the file carries from then on: store/critical.h. */
store_result_t store_replace_marked(store_t *store, const char *path, const void *bytes,
                                    size_t length, uint32_t generation);

/* The generation that |path| carries; 0 when it has none. */
store_result_t store_generation(store_t *store, const char *path, uint32_t *generation);

/* Whether files lay in |block|, one of the raw blocks, when the store was mounted. Since then they
 * can only have left. */
bool store_raw_taken(const store_t *store, uint32_t block);

/* Writes the blocks of all folders anew, both of each pair: what they held before is gone. */
store_result_t store_rewrite_folders(store_t *store);

/* Reads the whole of |path|: STORE_CORRUPT unless its length is exactly |length|. */
store_result_t store_load(store_t *store, const char *path, void *out, size_t length);

store_result_t store_size(store_t *store, const char *path, uint32_t *size_bytes);
store_result_t store_remove(store_t *store, const char *path);

/* CRC-32 (base/crc.h) over the whole file. */
store_result_t store_crc32(store_t *store, const char *path, uint32_t *crc);

/* Called for one entry; false ends the walk. */
typedef bool (*store_visit_t)(void *context, const store_entry_t *entry);

/* Visits the entries of a folder from number |first| on ("." and ".." are not counted). Looking for
 * an entry costs as much as a walk to it: walk once. |visit| must not write. */
store_result_t store_walk(store_t *store, const char *folder, uint32_t first, store_visit_t visit,
                          void *context);

/* Entry number |index| alone. STORE_NOT_FOUND past the end. */
store_result_t store_entry(store_t *store, const char *folder, uint32_t index,
                           store_entry_t *entry);

/* The highest number of a file in /trials; 0 when there is none. */
uint32_t store_newest_trial(store_t *store);

/* Removes the oldest files of /trials (lowest number first), never |keep_trial|, until |bytes| and
 * the reserve are free, then compacts, so that the trial itself need not. STORE_NO_SPACE when there
 * is nothing left to remove. One step removes one file, or compacts and sets |*done|; all of them
 * may take seconds on hardware: not while swimming. */
store_result_t store_make_space_step(store_t *store, uint32_t bytes, uint32_t keep_trial,
                                     bool *done);
store_result_t store_make_space(store_t *store, uint32_t bytes, uint32_t keep_trial);

#endif
