/* What the host gets of a picture. */
#ifndef SIM_CAMERA_FRAME_H
#define SIM_CAMERA_FRAME_H

/* One overhead picture, processed: where the fish is in the tank, x along it, y to the right, its
 * heading clockwise from above, and what else is to be seen. */
typedef struct {
    double time_s; /* simulated time, the middle of the exposure */
    double x_m, y_m, heading_rad;
    double tail_rad; /* real tail angle against the body, then */
    double led;      /* part of the exposure during which the board's LED was on, 0 to 1 */
} sim_camera_frame_t;

#endif
