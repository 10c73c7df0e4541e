/* What a simulated world and the board in it are made of. */
#ifndef SIM_SIM_CONFIG_H
#define SIM_SIM_CONFIG_H

#include <stdbool.h>
#include <stdint.h>

#define SIM_FLASH_BYTES (256u * 1024u)
#define SIM_FLASH_PAGE_BYTES 256u

typedef enum { SIM_PLANT_THESIS = 0, SIM_PLANT_TANK = 1, SIM_PLANT_REACTIVE = 2 } sim_plant_t;

/* All of it in SI units. sim_config_default fills it; every disturbance is off at 0. */
typedef struct {
    uint64_t seed;
    sim_plant_t plant;
    /* thesis plant (8.13) */
    double mass_kg, body_length_m, water_density_kg_m3, tail_area_m2, drag_kg_m;
    /* tank and reactive plant */
    double kappa_per_m;   /* drag over mass */
    double delay_s;       /* from amplitude to thrust */
    double slope_m_s_rad; /* steady speed over amplitude beyond the dead zone */
    double dead_zone_rad;
    double map_bend_m_s_rad2;  /* times the square of the amplitude beyond it, in that speed */
    double servo_lag_s;        /* first-order lag of the tail angle; 0 = none */
    double servo_rate_rad_s;   /* rate limit; 0 = none */
    double servo_backlash_rad; /* play between servo and tail; reactive plant only */
    /* reactive plant */
    double fin_depth_m;
    double thrust_exponent; /* of the mean thrust over the amplitude */
    double drag_linear;     /* linear drag over the quadratic one at 80 mm/s */
    double drag_per_rad;    /* relative growth of drag with the amplitude */
    double wake_share;      /* part of the thrust that follows ... */
    double wake_s;          /* ... with this time constant */
    double asymmetry;       /* starboard strokes are stronger by this part, port ones weaker */
    double collapse_rad;    /* beyond this amplitude thrust breaks down; 0 = never */
    double beat_s;          /* tail period of all plants; a multiple of 20 ms */
    double tail_centre_rad; /* the tail is mounted askew by this; its mean angle turns the fish */
    /* disturbances */
    double gain_sigma;        /* relative thrust speed, per trial */
    double flow_sigma_m_s;    /* constant per trial */
    double start_sigma_m_s;   /* |N| speed at the start */
    double flow_moves_m_s;    /* standard deviation of what the flow changes within a trial */
    double standing_wave_m_s; /* in the middle of the tank */
    double drift_sigma;       /* random walk of the thrust speed, relative, per trial */
    double drift_trend;       /* its trend per trial */
    double outliers;          /* part of the trials with a thrust or flow far off */
    double place_sigma_m;     /* where the hand puts the fish, either way ... */
    double place_sigma_rad;   /* ... and its nose */
    double lost_beats;        /* part of the beats of which the camera sees nothing */
    double camera_noise_m;    /* white, per frame */
    double camera_lost;       /* probability that a frame is lost */
    double camera_fps;
    double camera_exposure_s; /* up to 1 s, cut to a picture's period; 0 = a point in time */
    double camera_latency_s;  /* from mid-exposure to delivery, if over by then; at least 20 ms */
    double caught_after_s; /* after the last pulse somebody catches and holds the fish; 0 = never */
    double placed_after_s; /* after it somebody has put it back at the start, once it is caught; 0 =
                              when the next swim begins */
    double imu_noise;      /* scale of the VN-100's specified noise; 0 = none */
    double imu_bias_mg;    /* constant of the unit, standard deviation; times imu_noise */
    double imu_accel_scale, imu_rate_scale; /* standard deviation of the axes' scale errors */
    double imu_misaligned_rad;              /* ... of their directions */
    double roll_per_tail;                   /* how far the fish rolls with its tail, rad per rad */
    double roll_lag_rad;                    /* ... behind it, in phase */
    double cone_per_tail;                   /* ... and pitches a quarter beat before */
    double tremor_rad;                      /* of the hand that holds it between trials */
    double imu_firmware;                    /* its major version: 2, 3; 0 = there is no IMU */
    double imu_baud;                        /* that its port on the fish's wires has saved */
    double imu_port;                        /* of the sensor that the fish's wires are on: 1, 2 */
    double imu_bit_errors;                  /* probability per bit on its wires, either direction */
    double imu_lost_bytes;                  /* probability per byte */
    double battery_v;                       /* fresh pack */
    double battery_sag_v_per_trial;
    double battery_load_v;   /* pulled down by a tail that beats at 45 degrees */
    double link_bytes_per_s; /* of each direction; 0 = unlimited */
    double boot_s;           /* simulated time at which the board boots (its clock starts) */
} sim_config_t;

/* Tank and reactive: gain 0.02, flow 1.5 mm/s, start 2 mm/s, camera 1 mm, placed to 5 mm and
 * 1 degree; all off for the thesis plant. */
void sim_config_default(sim_config_t *config, sim_plant_t plant);

/* Whether every value makes sense. */
bool sim_config_valid(const sim_config_t *config);

#endif
