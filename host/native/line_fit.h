/*
 * Mean speed over a sliding window of one beat, from positions as they come: the slope of the least
 * squares line, and its standard deviation by the scatter about the line. Pure; the caller owns the
 * window. Not for interrupts.
 */
#ifndef LINE_FIT_H
#define LINE_FIT_H

#include <stdbool.h>
#include <stddef.h>

/* Of one window: a beat of 4 s at 1000 pictures per second. */
#define LINE_FIT_POSITIONS_MAX 4096u

typedef struct {
    double beat_s;                /* length of the window, both ends included; > 0 */
    double slack_s;               /* by which its length may differ; >= 0 */
    double gap_max_s;             /* between two positions, beyond which nothing comes out */
    double speed_max_m_s, jump_m; /* a step that is further begins a new window */
    double sigma_min_m_s;
    size_t positions_min; /* of a window; >= 3, at most LINE_FIT_POSITIONS_MAX */
    size_t first, count;  /* 0 at the begin, and to forget all positions */
    double t_s[LINE_FIT_POSITIONS_MAX], x_m[LINE_FIT_POSITIONS_MAX];
} line_fit_t;

typedef struct {
    double t_s; /* middle of the window */
    double speed_m_s, sigma_m_s;
} line_fit_speed_t;

/* Takes one position; one that is no number, or not newer than the last, is dropped. False while
 * there is no speed: the window is not one beat long yet, or lacks too much. Cost: some 30 ns for a
 * window of 26 positions. */
bool line_fit_add(line_fit_t *fit, double t_s, double x_m, line_fit_speed_t *speed);

#endif
