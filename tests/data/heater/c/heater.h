#ifndef RTW_HEADER_heater_h_
#define RTW_HEADER_heater_h_
#include <stdint.h>
typedef double real_T; typedef float real32_T; typedef int32_t int32_T; typedef uint32_t uint32_T; typedef unsigned char boolean_T; typedef uint8_t uint8_T;
/* Block signals and states (default storage) for system '<Root>' */
typedef struct {
  real_T Integrator_DSTATE;            /* '<S1>/Integrator' */
  real_T Delay_DSTATE[100];            /* '<Root>/Delay' */
  uint32_T CircBufIdx;
} DW;
/* External inputs (root inport signals with default storage) */
typedef struct {
  real_T r;                            /* '<Root>/r' */
  real_T y;                            /* '<Root>/y' */
} ExtU;
/* External outputs (root outports fed by signals with default storage) */
typedef struct {
  real_T u;                            /* '<Root>/u' */
} ExtY;
/* Parameters (default storage) */
struct P_ {
  real_T Kp;                           /* Variable: Kp */
  real_T Ki;
};
typedef struct P_ P;
typedef struct tag_RTM { const char *errorStatus; double *now; struct { uint32_T clockTick0; double t; } Timing; } RT_MODEL;
extern DW rtDW;
extern ExtU rtU;
extern ExtY rtY;
extern P rtP;
extern void heater_initialize(void);
extern void heater_step(void);
extern void heater_terminate(void);
extern RT_MODEL *const rtM;
#endif
