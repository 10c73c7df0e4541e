/* Which worlds can be simulated. */
#ifndef SIM_CONFIG_VALID_H
#define SIM_CONFIG_VALID_H

#include "common/sim_config.h"

#include <stdbool.h>

/* Whether every value makes sense. */
bool sim_config_valid(const sim_config_t *config);

#endif
