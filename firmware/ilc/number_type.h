/* The type of number.h, for those who need no more of it. */
#ifndef ILC_NUMBER_TYPE_H
#define ILC_NUMBER_TYPE_H

#ifdef ILC_DOUBLE
typedef double number_t;
#else
typedef float number_t;
#endif

#endif
