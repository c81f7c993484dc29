#include "heater.h"
#include <string.h>
DW rtDW;
ExtU rtU;
ExtY rtY;
static RT_MODEL rtM_;
RT_MODEL *const rtM = &rtM_;
static double *last = &rtDW.Delay_DSTATE[3];
static int calls(void) { static int n = 7; return ++n; }
void heater_step(void)
{
  real_T e = rtU.r - rtU.y;
  real_T d = rtDW.Delay_DSTATE[rtDW.CircBufIdx];
  rtDW.Delay_DSTATE[rtDW.CircBufIdx] = e;
  if (rtDW.CircBufIdx < 99U) rtDW.CircBufIdx++; else rtDW.CircBufIdx = 0U;
  rtY.u = rtP.Kp * e + rtDW.Integrator_DSTATE + 0.01 * (e - d) + 1e-6 * calls() + *last;
  last = &rtDW.Delay_DSTATE[(rtDW.CircBufIdx * 7) % 100];
  rtDW.Integrator_DSTATE += rtP.Ki * 0.01 * e;
  *rtM->now += 0.01;
  rtM->Timing.clockTick0++;
  rtM->errorStatus = rtM->Timing.clockTick0 > 10 ? "late" : 0;
}
void heater_initialize(void)
{
  memset((void *)rtM, 0, sizeof(RT_MODEL));
  rtM->now = &rtM->Timing.t;
  (void)memset((void *)&rtDW, 0, sizeof(DW));
  rtY.u = 0.0;
}
void heater_terminate(void) {}
