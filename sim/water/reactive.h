/*
 * A rigid body with a rigid tail link in still water, by the theory of reactive forces: the large-
 * amplitude elongated-body theory of M. J. Lighthill (Proc. R. Soc. Lond. B 179, 1971, eq. 4 to 7),
 * in three degrees of freedom: surge, sway, yaw. It shares no code and no equation with plant.h.
 *
 * The momentum of body and water together changes by what is shed at the edge of the fin and by
 * drag (Kirchhoff's equations in the frame of the body); the speeds follow from the momentum and
 * from how fast the tail turns. So a jump of the tail's rate, as a servo makes it, needs no
 * acceleration of the tail: the momentum goes on without a jump.
 *
 * Body frame: x forward, y to starboard, z down; yaw clockwise from above. The hinge of the tail
 * lies |hinge_m| behind the centre of mass. A positive tail angle has the tip to port.
 *
 * Pure; the caller owns the structs.
 */
#ifndef SIM_REACTIVE_H
#define SIM_REACTIVE_H

#define REACTIVE_STEP_S 0.005
#define REACTIVE_RING 1024u /* steps; a power of two */
#define REACTIVE_DELAY_MAX_S 5.0

typedef struct {
    double mass_kg;         /* with what surges with it */
    double sway_mass_kg;    /* with the water beside the body */
    double inertia_kg_m2;   /* about the vertical, likewise */
    double hinge_m, tail_m; /* from the centre of mass to the hinge, from there to the fin's edge */
    double fin_m;           /* the fin's length; the rest of the link is a thin peduncle */
    double fin_depth_m;
    double peduncle_depth_m;
    double water_kg_m3;
    double drag_kg_m;                      /* force over speed squared, surge */
    double drag_linear_kg_s;               /* force over speed */
    double drag_per_rad;                   /* relative growth of both with the tail's amplitude */
    double sway_drag_kg_m, yaw_drag_kg_m2; /* force over speed squared, moment over rate squared */
    double fin_drag;                       /* resistance coefficient of the fin across its plane */
    double thrust_exponent;    /* of the mean thrust over the amplitude; 2 = the theory's */
    double collapse_rad;       /* beyond this amplitude the flow separates; 0 = never */
    double asymmetry;          /* what is shed to starboard is larger by this part, to port less */
    double wake_share, wake_s; /* part of the thrust that follows with this time constant */
    double delay_s;            /* of all of it; at most REACTIVE_DELAY_MAX_S */
} reactive_config_t;

/* Over the water, in the frame of the body. */
typedef struct {
    double surge_m_s, sway_m_s, yaw_rad_s;
} reactive_speed_t;

typedef struct {
    double momentum[3];       /* kg m/s, kg m/s, kg m^2/s */
    double x_m, y_m, yaw_rad; /* over the water */
    double envelope_rad2;     /* twice the mean square of the tail angle: amplitude squared */
    double wake_n;            /* the thrust that follows */
    unsigned step;
    double thrust_n[REACTIVE_RING]; /* by step, for the delay */
} reactive_t;

/* At rest in the water with the tail straight; no thrust is under way. */
void reactive_init(reactive_t *fish);

/* Gives it the speed of |speed| with the tail at |tail_rad| that turns by |tail_rad_s|. */
void reactive_set_speed(reactive_t *fish, const reactive_config_t *config, double tail_rad,
                        double tail_rad_s, reactive_speed_t speed);

reactive_speed_t reactive_speed(const reactive_t *fish, const reactive_config_t *config,
                                double tail_rad, double tail_rad_s);

/* One step of at most REACTIVE_STEP_S, by which delays are counted, during which the tail turns
 * evenly from one angle to the other. |omega_rad_s|: of the tail beat, for the envelope.
 * Fourth-order Runge-Kutta: about 700 double operations. */
void reactive_step(reactive_t *fish, const reactive_config_t *config, double gain,
                   double tail_from_rad, double tail_to_rad, double omega_rad_s, double dt_s);

#endif
