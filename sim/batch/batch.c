#include "batch.h"

#include "batch_lanes.h"
#include "common/noise.h"
#include "config_valid.h"
#include "fish/tail.h"
#include "water/disturbance.h"
#include "water/drag_step.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Of a picture period, as the camera's. */
#define EXPOSURE_PHASE 0.33
#define COVERAGE_MIN 0.6
#define FRAME_US 20000u
#define RIPPLE_MAX 2.0
#define ROUNDING 1e-6 /* more than that of all that has been computed */

static const double still[SUBSTEPS] = {1, 1, 1, 1};

/* What the whole call shares. */
typedef struct {
    const batch_lanes_t *lanes;
    const sim_config_t *configs;
    const uint32_t *swims;
    const double *amplitude_rad;
    size_t beats;
    double beat_s;
    double *true_m_s, *speed_m_s, *sigma_m_s;
    const tail_t *tail;
} task_t;

/* Fish |first| and the |count| - 1 after it. Lanes without a fish swim as the first. */
typedef struct {
    const task_t *task;
    size_t first;
    unsigned count;
    double fps;     /* 0 = no pictures are wanted */
    uint64_t beat;  /* the present one */
    uint32_t frame; /* of that beat */
    uint64_t picture, next_window;
    uint64_t picture_us; /* when the next picture is taken; UINT64_MAX = none */
    bool alone;          /* one fish, by the plant's own code; otherwise all lanes at once */
    tail_t tail;
    plant_t plant;
    disturbance_t drawn[BATCH_LANES];
    batch_block_t rows;
} block_t;

/* Too much for the stack of a thread. The ring follows it. */
typedef struct {
    void *memory; /* from malloc; what lies here is aligned */
    task_t task;
    tail_t tail;
    block_t block;
} work_t;

static size_t fish_of(const block_t *block, unsigned lane) {
    return block->first + (lane < block->count ? lane : 0);
}

/* When the present frame begins, since the swim did. */
static uint64_t frame_us(const block_t *block) {
    return (block->beat * block->task->tail->frames_per_beat + block->frame) * FRAME_US;
}

static bool has_servo(const sim_config_t *c) {
    return c->servo_lag_s > 0 || c->servo_rate_rad_s > 0;
}

/* Over water, of the present beat; it begins at begin_m. */
static double lane_way_m(const batch_block_t *rows, unsigned lane) {
    const double dt = rows->frame_s / SUBSTEPS;
    return rows->summed ? drag_way(rows->sum_m_s[SUBSTEPS][lane], rows->v_m_s[SUBSTEPS][lane], dt,
                                   rows->twelfth[lane])
                        : rows->way_m[SUBSTEPS][lane];
}

/* By moving water, of the present beat. */
static double lane_drift_m(const batch_block_t *rows, unsigned lane) {
    return rows->drifted_m[lane] + rows->drift_m_s[lane] * rows->frame_s;
}

static void set_water(block_t *block, unsigned l, const sim_config_t *c, uint32_t swim) {
    batch_block_t *rows = &block->rows;
    disturbance_draw(&block->drawn[l], c, swim);
    const double gain = block->drawn[l].gain;
    const double h = rows->frame_s / SUBSTEPS;
    const double start_m_s = block->drawn[l].start_m_s;
    rows->v_m_s[SUBSTEPS][l] = start_m_s;
    rows->flow_m_s[l] = block->drawn[l].flow_m_s;
    rows->drifts = rows->drifts || block->drawn[l].moves;
    rows->kt[l] = c->kappa_per_m * h;
    rows->twice_kt[l] = 2 * rows->kt[l];
    rows->kt_fifteenth[l] = rows->kt[l] * (1.0 / 15.0);
    rows->twelfth[l] = drag_twelfth(rows->kt[l], h);
    rows->half_slope[l] = 0.5 * (gain * c->slope_m_s_rad);
    rows->quarter_bend[l] = 0.25 * (gain * c->map_bend_m_s_rad2);
    rows->twice_dead_zone_rad[l] = 2 * c->dead_zone_rad;
    rows->delay_steps[l] = tank_delay(c->delay_s, &rows->delay_fraction[l]);
    const tail_servo_t servo = tail_servo(c->servo_lag_s, c->servo_rate_rad_s, rows->frame_s);
    rows->settle[l] = servo.settle;
    rows->ahead_frames[l] = servo.ahead_frames;
    rows->most_rad[l] = servo.most_rad;
    rows->tail_rad[0][l] = rows->tail_rad[1][l] = rows->late[l] = rows->base_m[l] = 0;
    rows->late_most[l] = start_m_s * start_m_s / RIPPLE_MAX;
    rows->ahead[l] = cos(block->drawn[l].place_rad);
    rows->sway_m_per_rad[l] =
        c->plant == SIM_PLANT_REACTIVE ? 0 : SWAY_M_PER_RAD * sin(block->drawn[l].place_rad);
    rows->bends = rows->bends || fabs(rows->quarter_bend[l]) > 0;
}

static void set_camera(batch_block_t *rows, unsigned l, const sim_config_t *c, uint32_t swim) {
    rows->noise_m[l] = c->camera_noise_m;
    rows->noise_key[l] = noise_key(c->seed, NOISE_CAMERA, swim);
    rows->lost_key[l] = noise_key(c->seed, NOISE_LOST, swim);
    rows->lost_below[l] = (uint64_t)ceil(c->camera_lost * 0x1p53);
    rows->lossy = rows->lossy || rows->lost_below[l] > 0;
}

static uint64_t next_picture_us(const block_t *block) {
    const double periods = (double)block->picture + EXPOSURE_PHASE;
    return block->fps > 0 ? (uint64_t)(periods * 1e6 / block->fps) : UINT64_MAX;
}

static void set_windows(block_t *block) {
    batch_block_t *rows = &block->rows;
    const double periods = floor(block->task->beat_s * block->fps + 0.5);
    rows->pictures_per_window = (uint32_t)periods + 1;
    rows->pictures_min = (uint32_t)fmax(3, ceil(COVERAGE_MIN * (periods + 1)));
    rows->half_window_s = block->fps > 0 ? 0.5 * periods / block->fps : 0;
    rows->window[0].open = rows->window[1].open = false;
    block->picture = block->next_window = 0;
    if (rows->pictures_per_window < 3) {
        block->fps = 0;
    }
    block->picture_us = next_picture_us(block);
}

/* Of a ring that remembers so many substeps. */
static uint64_t mask_for(uint64_t delay_steps) {
    uint64_t mask = 7;
    while (mask + 1 < delay_steps + SUBSTEPS) {
        mask = 2 * mask + 1;
    }
    return mask;
}

static size_t ring_bytes(uint64_t mask) { return (size_t)(mask + 1) * sizeof(batch_row_t); }

static void clear_thrust(batch_block_t *rows) {
    uint64_t longest = 0;
    rows->same_delay = rows->whole_delay = true;
    for (unsigned l = 0; l < rows->lanes; l++) {
        longest = rows->delay_steps[l] > longest ? rows->delay_steps[l] : longest;
        rows->same_delay = rows->same_delay && rows->delay_steps[l] == rows->delay_steps[0];
        rows->whole_delay = rows->whole_delay && !(rows->delay_fraction[l] > 0);
    }
    rows->ring_mask = mask_for(longest);
    memset(rows->thrust, 0, ring_bytes(rows->ring_mask));
}

static void begin(block_t *block) {
    const task_t *task = block->task;
    batch_block_t *rows = &block->rows;
    rows->frame_s = task->beat_s / task->tail->frames_per_beat;
    rows->to_amplitude = tail_to_amplitude(task->tail, rows->frame_s);
    rows->has_servo = has_servo(&task->configs[block->first]);
    rows->lossy = false;
    rows->lanes = (block->count + BATCH_STEP - 1) / BATCH_STEP * BATCH_STEP;
    rows->step = 0;
    rows->summed = !block->alone || block->plant.kind == SIM_PLANT_TANK;
    rows->drifts = rows->bends = false;
    for (unsigned l = 0; l < rows->lanes; l++) {
        const size_t fish = fish_of(block, l);
        set_water(block, l, &task->configs[fish], task->swims[fish]);
        set_camera(rows, l, &task->configs[fish], task->swims[fish]);
    }
    clear_thrust(rows);
    set_windows(block);
}

/* Of a fish whose path is no line: along its heading. Nobody has trimmed its tail. */
static void frame_reactive(block_t *block, const drive_t *drive) {
    batch_block_t *rows = &block->rows;
    plant_t *plant = &block->plant;
    const double way_m = rows->way_m[SUBSTEPS][0];
    const double ahead = plant->motion.cosine, aside = plant->motion.sine;
    plant_frame(plant, drive, block->task->configs[block->first].tail_centre_rad, rows->frame_s);
    const plant_point_t *trace = plant->motion.trace;
    for (unsigned i = 0; i <= SUBSTEPS; i++) {
        rows->v_m_s[i][0] = trace[i].vx_m_s * ahead + trace[i].vy_m_s * aside;
        rows->way_m[i][0] =
            way_m + (trace[i].x_m - trace[0].x_m) * ahead + (trace[i].y_m - trace[0].y_m) * aside;
    }
}

/* Of a fish whose path is a line. */
static void frame_straight(block_t *block, const drive_t *drive) {
    batch_block_t *rows = &block->rows;
    plant_t *plant = &block->plant;
    const double dt = rows->frame_s / SUBSTEPS;
    double v = rows->v_m_s[SUBSTEPS][0];
    double sum = rows->sum_m_s[SUBSTEPS][0], way_m = rows->way_m[SUBSTEPS][0];
    for (unsigned i = 0; i <= SUBSTEPS; i++) {
        rows->v_m_s[i][0] = v;
        rows->sum_m_s[i][0] = sum;
        rows->way_m[i][0] = way_m;
        if (i < SUBSTEPS && plant->kind == SIM_PLANT_TANK) {
            sum += tank_sum_step(&plant->tank, &v, drive, i, plant->gain, dt);
        } else if (i < SUBSTEPS) {
            way_m += thesis_step(&plant->thesis, &v, drive->amplitude_rad[i], plant->gain, dt);
        }
    }
}

/* The frame of the fish that swims alone; |next_sine| as of batch_frame_t. */
static void frame_alone(block_t *block, double next_sine, bool limp) {
    batch_block_t *rows = &block->rows;
    drive_t drive = {{0, 0, 0, 0}, {1, 1, 1, 1}, {1, 1, 1, 1}, {0, 0}};
    if (!limp || block->tail.has_servo) {
        tail_frame_sine(&block->tail, rows->amplitude_rad[0], rows->frame_s, &drive);
    }
    rows->tail_rad[0][0] = rows->tail_rad[1][0];
    rows->tail_rad[1][0] =
        rows->has_servo ? block->tail.servo_rad : rows->amplitude_rad[0] * next_sine;
    if (block->plant.kind == SIM_PLANT_REACTIVE) {
        frame_reactive(block, &drive);
    } else {
        frame_straight(block, &drive);
    }
}

static void store_fit(block_t *block, batch_window_t *window) {
    const task_t *task = block->task;
    task->lanes->fit(&block->rows, window);
    for (unsigned l = 0; l < block->count; l++) {
        const size_t at = (block->first + l) * task->beats + (size_t)window->beat;
        const bool hidden = disturbance_hides(&block->drawn[l], window->beat);
        task->speed_m_s[at] = hidden ? (double)NAN : block->rows.speed_m_s[l];
        task->sigma_m_s[at] = hidden ? (double)NAN : block->rows.sigma_m_s[l];
    }
    window->open = false;
}

static void open_window(block_t *block, double time_s) {
    batch_window_t *window = &block->rows.window[block->beat & 1u];
    memset(window, 0, sizeof *window);
    window->open = true;
    window->beat = block->beat;
    window->begin_s = time_s;
    memcpy(window->offset_m, block->rows.base_m, sizeof window->offset_m);
}

static void take_picture(block_t *block, uint64_t time_us) {
    const uint32_t in_frame_us = (uint32_t)(time_us - frame_us(block));
    const double part = (double)in_frame_us / FRAME_US * SUBSTEPS;
    const batch_picture_t picture = {
        .sample = block->picture,
        .time_s = (double)time_us * 1e-6,
        .in_beat_s = (double)(block->frame * FRAME_US + in_frame_us) * 1e-6,
        .substep = (unsigned)part,
        .part = part - (unsigned)part,
    };
    batch_window_t *window = block->rows.window;
    if (block->beat >= block->next_window && block->beat < block->task->beats) {
        open_window(block, picture.time_s);
        block->next_window = block->beat + 1;
    }
    block->task->lanes->picture(&block->rows, &picture);
    for (unsigned i = 0; i < 2; i++) {
        if (window[i].open && ++window[i].taken == block->rows.pictures_per_window) {
            store_fit(block, &window[i]);
        }
    }
}

/* The pictures out of the present frame, once it is computed. */
static void look(block_t *block) {
    const uint64_t end_us = frame_us(block) + FRAME_US;
    while (block->picture_us < end_us) {
        take_picture(block, block->picture_us);
        block->picture++;
        block->picture_us = next_picture_us(block);
    }
}

/* The moving part of the flow, in the frame to come: held for that frame, as the world holds it. */
static void drift(block_t *block) {
    batch_block_t *rows = &block->rows;
    const double since_s = (double)(frame_us(block) / FRAME_US) * rows->frame_s;
    const double in_beat_s = block->frame * rows->frame_s;
    for (unsigned l = 0; l < block->count; l++) {
        rows->drifted_m[l] = lane_drift_m(rows, l);
        const double x_m = rows->base_m[l] + lane_way_m(rows, l) + rows->drifted_m[l] +
                           rows->flow_m_s[l] * in_beat_s;
        rows->drift_m_s[l] = disturbance_flow_m_s(&block->drawn[l], since_s, x_m);
    }
}

static void swim_frame(block_t *block, bool limp) {
    const tail_t *tail = block->task->tail;
    const uint32_t frame = block->frame;
    const double *sine = tail->sine + frame;
    if (block->rows.drifts) {
        drift(block);
    }
    if (block->alone) {
        frame_alone(block, sine[1], limp);
    } else {
        const batch_frame_t now = {sine[0], sine[1],
                                   limp ? still : tail->ripple + frame * SUBSTEPS};
        block->task->lanes->frame(&block->rows, &now);
    }
    look(block);
    block->frame++;
}

/* The way is counted anew. */
static void begin_beat(block_t *block, size_t beat) {
    const task_t *task = block->task;
    batch_block_t *rows = &block->rows;
    block->beat = beat;
    block->frame = 0;
    for (unsigned l = 0; l < rows->lanes; l++) {
        rows->sum_m_s[SUBSTEPS][l] = rows->way_m[SUBSTEPS][l] = 0;
        rows->drifted_m[l] = rows->drift_m_s[l] = 0;
        rows->begin_m[l] = lane_way_m(rows, l);
        rows->base_m[l] -= rows->begin_m[l];
        rows->amplitude_rad[l] =
            beat < task->beats ? fabs(task->amplitude_rad[fish_of(block, l) * task->beats + beat])
                               : 0;
    }
}

static void end_beat(block_t *block) {
    const task_t *task = block->task;
    batch_block_t *rows = &block->rows;
    for (unsigned l = 0; l < block->count; l++) {
        task->true_m_s[(block->first + l) * task->beats + (size_t)block->beat] =
            (lane_way_m(rows, l) - rows->begin_m[l] + lane_drift_m(rows, l)) / task->beat_s +
            rows->flow_m_s[l];
    }
    for (unsigned l = 0; l < rows->lanes; l++) {
        rows->base_m[l] = rows->base_m[l] + lane_way_m(rows, l) + lane_drift_m(rows, l) +
                          rows->flow_m_s[l] * task->beat_s;
    }
}

static void swim_beats(block_t *block) {
    const task_t *task = block->task;
    const batch_block_t *rows = &block->rows;
    const uint32_t frames = task->tail->frames_per_beat;
    for (size_t k = 0; k < task->beats; k++) {
        begin_beat(block, k);
        for (uint32_t i = 0; i < frames; i++) {
            swim_frame(block, false);
        }
        end_beat(block);
    }
    /* The last beat's window closes a picture later, with the tail limp. */
    begin_beat(block, task->beats);
    for (uint32_t i = 0; i < frames && (rows->window[0].open || rows->window[1].open); i++) {
        swim_frame(block, true);
    }
}

static void fill_unmeasured(const block_t *block) {
    const task_t *task = block->task;
    if (task->speed_m_s == NULL) {
        return;
    }
    const size_t begin = block->first * task->beats;
    for (size_t i = begin; i < begin + block->count * task->beats; i++) {
        task->speed_m_s[i] = task->sigma_m_s[i] = (double)NAN;
    }
}

static void swim_block(block_t *block) {
    const task_t *task = block->task;
    block->fps = task->speed_m_s != NULL ? task->configs[block->first].camera_fps : 0;
    begin(block);
    fill_unmeasured(block);
    swim_beats(block);
}

/* By the simulator's own code, for what the lanes cannot do. */
static void swim_alone(block_t *block, size_t fish) {
    const task_t *task = block->task;
    sim_config_t timed = task->configs[fish];
    timed.beat_s = task->beat_s;
    tail_init(&block->tail, &timed, task->tail->frames_per_beat);
    plant_init(&block->plant, &timed);
    disturbance_t drawn;
    disturbance_draw(&drawn, &timed, task->swims[fish]);
    plant_begin(&block->plant, drawn.start_m_s, drawn.gain, 0);
    block->first = fish;
    block->count = 1;
    block->alone = true;
    swim_block(block);
    block->alone = false;
}

static bool alike(const sim_config_t *a, const sim_config_t *b) {
    return a->plant == SIM_PLANT_TANK && b->plant == SIM_PLANT_TANK &&
           has_servo(a) == has_servo(b) && a->camera_fps >= b->camera_fps &&
           a->camera_fps <= b->camera_fps;
}

/* Whether drag_step took its fraction in every step of lane |l|. The fish was never faster than at
 * its begin, or than it would have settled at: one limit holds for its speed and for its thrust. */
static bool all_in_fraction(const batch_block_t *rows, unsigned l) {
    return RIPPLE_MAX * rows->late_most[l] * rows->kt[l] * rows->kt[l] <
           (1 - ROUNDING) * DRAG_FRACTION_MOST * DRAG_FRACTION_MOST;
}

/* Returns how many fish it took. */
static size_t swim_some(block_t *block, size_t first, size_t fish) {
    const task_t *task = block->task;
    unsigned count = 0;
    while (count < BATCH_LANES && first + count < fish &&
           alike(&task->configs[first], &task->configs[first + count])) {
        count++;
    }
    if (count < 2) { /* one: no set of instructions would swim it faster */
        swim_alone(block, first);
        return 1;
    }
    block->first = first;
    block->count = count;
    swim_block(block);
    uint64_t wrong = 0;
    for (unsigned l = 0; l < count; l++) {
        wrong |= all_in_fraction(&block->rows, l) ? 0 : (uint64_t)1 << l;
    }
    for (unsigned l = 0; l < count; l++) {
        if ((wrong >> l & 1u) != 0) {
            swim_alone(block, first + l);
        }
    }
    return count;
}

static bool valid(const task_t *task, size_t fish) {
    for (size_t i = 0; i < fish; i++) {
        if (!sim_config_valid(&task->configs[i])) {
            return false;
        }
    }
    for (size_t i = 0; i < fish * task->beats; i++) {
        if (!isfinite(task->amplitude_rad[i])) {
            return false;
        }
    }
    return (task->speed_m_s == NULL) == (task->sigma_m_s == NULL);
}

static uint64_t longest_delay(const sim_config_t *configs, size_t fish) {
    double longest_s = 0, fraction;
    for (size_t i = 0; i < fish; i++) {
        longest_s = fmax(longest_s, configs[i].delay_s);
    }
    return tank_delay(longest_s, &fraction);
}

/* NULL without memory. */
static work_t *new_work(const task_t *task, size_t fish) {
    const size_t ring = ring_bytes(mask_for(longest_delay(task->configs, fish)));
    /* Windows has no aligned_alloc. */
    char *memory = malloc(_Alignof(work_t) + sizeof(work_t) + ring);
    work_t *work = NULL;
    if (memory != NULL) {
        work = (work_t *)(memory + _Alignof(work_t) - (uintptr_t)memory % _Alignof(work_t));
        memset(work, 0, sizeof *work);
        work->memory = memory;
        work->task = *task;
        work->task.tail = &work->tail;
        work->block.task = &work->task;
        work->block.rows.thrust = (batch_row_t *)(work + 1);
    }
    return work;
}

bool batch_swim_on(const batch_lanes_t *lanes, const sim_config_t *configs, size_t fish,
                   const uint32_t *swims, const double *amplitude_rad, size_t beats, double beat_s,
                   double *true_m_s, double *speed_m_s, double *sigma_m_s) {
    const uint32_t frames = tail_beat_frames(beat_s);
    const task_t task = {.lanes = lanes,
                         .configs = configs,
                         .swims = swims,
                         .amplitude_rad = amplitude_rad,
                         .beats = beats,
                         .beat_s = beat_s,
                         .true_m_s = true_m_s,
                         .speed_m_s = speed_m_s,
                         .sigma_m_s = sigma_m_s};
    if (frames == 0 || !valid(&task, fish)) {
        return false;
    }
    if (fish == 0 || beats == 0) {
        return true;
    }
    work_t *work = new_work(&task, fish);
    if (work == NULL) {
        return false;
    }
    sim_config_t timed = configs[0];
    timed.beat_s = beat_s;
    tail_init(&work->tail, &timed, frames);
    for (size_t first = 0; first < fish;) {
        first += swim_some(&work->block, first, fish);
    }
    free(work->memory);
    return true;
}

bool batch_swim(const sim_config_t *configs, size_t fish, const uint32_t *swims,
                const double *amplitude_rad, size_t beats, double beat_s, double *true_m_s,
                double *speed_m_s, double *sigma_m_s) {
    const batch_lanes_t *best = batch_lanes(0);
    for (size_t i = 1; batch_lanes(i) != NULL; i++) {
        best = batch_lanes(i);
    }
    return batch_swim_on(best, configs, fish, swims, amplitude_rad, beats, beat_s, true_m_s,
                         speed_m_s, sigma_m_s);
}
