/*
 * A plant of your own for tailbeat's Monte Carlo studies: a fish (or anything that swims by beats)
 * compiled elsewhere. Build a shared library with these two functions,
 *
 *     cc -shared -fPIC -O2 -o my_fish.so my_fish.c -lm
 *     tailbeat sim montecarlo populations --plant ./my_fish.so
 *
 * and any recipe runs on it: identification, learning, the error bound by the plant itself. The
 * library is called from one thread of each of several processes; it must keep nothing from one
 * call to the next, so that the same arguments always give the same answer.
 */
#ifndef TAILBEAT_PLANT_H
#define TAILBEAT_PLANT_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define TAILBEAT_PLANT_ABI 1u

/* TAILBEAT_PLANT_ABI, as it was when the library was compiled. */
uint32_t tailbeat_plant_abi(void);

/* One trial, from rest.
 *
 * |seed|: which fish, and all of its randomness. |trial|: its number, from 1 on, identification
 * runs among them; the noise of a trial belongs to both. 0: the same fish without noise, drift and
 * disturbance, by which inputs are judged. |beat_s|: length of a beat, > 0. |beats|: how many, 1 to
 * 512.
 * |amplitude_rad|: of the tail in each beat, 0 to about 0.8, |beats| values; what a beat commands
 * may act later. |bias_rad|: the tail's mean angle in each beat, positive to port; 0 today.
 * |speed_m_s|: filled with the true mean speed over ground of each beat, along the path; NaN where
 * no camera sees it. |heading_rad|: filled with the mean heading of each beat, clockwise from
 * above, from 0 at the begin; what a plant does not know stays as it is (0).
 * The caller owns all buffers. False, and nothing written, for what the plant cannot do. */
bool tailbeat_plant_trial(uint64_t seed, uint32_t trial, double beat_s, uint32_t beats,
                          const double *amplitude_rad, const double *bias_rad, double *speed_m_s,
                          double *heading_rad);

#ifdef __cplusplus
}
#endif

#endif
