/*
 * The 3.3 V rail, as the chip's supply monitor sees it (switched on in startup.c). This is not the
 * battery: the rail stays up long after the servo has gone weak. It is the last chance not to begin
 * what cannot be finished.
 */
#include "board.h"
#include "registers/supc.h"

bool supply_good(void) { return (SUPC->SR & SUPC_SR_SMOS) == 0; }
