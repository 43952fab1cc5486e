/* FMI 2.0 co-simulation of an identified multirotor model: fixed Runge-Kutta steps of `step`, cut at the very times at which delayed inputs
 * change. Sizes, delays and start values are in fmu_data.h, the model in flighttest_model.c. Frames: world North-West-Up, body
 * Forward-Left-Up. Value references: inputs 0 .. N_IN-1, outputs 100 .., start values of states 200 .. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "flighttest_model.h"
#include "fmu_data.h"

#if defined(_WIN32)
#define API __declspec(dllexport)
#else
#define API __attribute__((visibility("default")))
#endif

typedef void *fmi2Component;
typedef void *fmi2ComponentEnvironment;
typedef void *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef char fmi2Char;
typedef const fmi2Char *fmi2String;
typedef char fmi2Byte;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;

#define OUTPUT_REF 100u
#define START_REF 200u

typedef struct {
  double x[N_X], start[N_X], given[N_IN];
  double t;
  double *when, *what; /* history of inputs: times (size), values (size, N_IN) */
  size_t used, size;
} Vehicle;

static int remember(Vehicle *v) {
  const size_t n = v->used;
  if (n && memcmp(v->what + (n - 1) * N_IN, v->given, sizeof v->given) == 0) return 1;
  if (n && v->when[n - 1] >= v->t) {
    memcpy(v->what + (n - 1) * N_IN, v->given, sizeof v->given);
    return 1;
  }
  if (n == v->size) {
    size_t gone = 0;
    while (gone + 1 < n && v->when[gone + 1] <= v->t - LONGEST_DELAY_S) ++gone;
    if (gone > n / 2) {
      memmove(v->when, v->when + gone, (n - gone) * sizeof(double));
      memmove(v->what, v->what + gone * N_IN, (n - gone) * N_IN * sizeof(double));
      v->used = n - gone;
      return remember(v);
    } else {
      const size_t more = 2 * v->size + 64;
      double *when = realloc(v->when, more * sizeof(double)), *what;
      if (!when) return 0;
      v->when = when;
      what = realloc(v->what, more * N_IN * sizeof(double));
      if (!what) return 0;
      v->what = what;
      v->size = more;
    }
  }
  v->when[v->used] = v->used ? v->t : -1e30;
  memcpy(v->what + v->used * N_IN, v->given, sizeof v->given);
  ++v->used;
  return 1;
}

/* Inputs in force at t, and the time of the next change (at most until). */
static double in_force(const Vehicle *v, double t, double until, double *u) {
  int k;
  for (k = 0; k < N_IN; ++k) {
    size_t i = v->used;
    while (i > 1 && v->when[i - 1] + DELAY_S[k] > t + 1e-12) --i;
    u[INPUT_AT[k]] = v->what[(i - 1) * N_IN + k];
    while (i < v->used && v->what[i * N_IN + k] == u[INPUT_AT[k]]) ++i;
    if (i < v->used && v->when[i] + DELAY_S[k] < until) until = v->when[i] + DELAY_S[k];
  }
  return until;
}

static void measured(const Vehicle *v, double *y) {
  double u[N_U], w[outputs_SZ_W + 1];
  const double *arg[outputs_SZ_ARG] = {0};
  double *res[outputs_SZ_RES] = {0};
  int iw[outputs_SZ_IW + 1];
  in_force(v, v->t, v->t, u);
  if (TIME_AT >= 0) u[TIME_AT < 0 ? 0 : TIME_AT] = v->t;
  arg[0] = v->x;
  arg[1] = u;
  res[0] = y;
  outputs(arg, res, iw, w, 0);
}

API const char *fmi2GetTypesPlatform(void) { return "default"; }
API const char *fmi2GetVersion(void) { return "2.0"; }
API fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[]) {
  (void)c; (void)on; (void)n; (void)names;
  return fmi2OK;
}

API fmi2Status fmi2Reset(fmi2Component c) {
  Vehicle *v = c;
  memcpy(v->start, START_X, sizeof v->start);
  memcpy(v->x, START_X, sizeof v->x);
  memcpy(v->given, START_U, sizeof v->given);
  v->t = 0.0;
  v->used = 0;
  return fmi2OK;
}

API void fmi2FreeInstance(fmi2Component c) {
  Vehicle *v = c;
  if (!v) return;
  free(v->when);
  free(v->what);
  free(v);
}

API fmi2Component fmi2Instantiate(fmi2String name, int type, fmi2String guid, fmi2String place, const void *functions,
                                  fmi2Boolean visible, fmi2Boolean logging) {
  Vehicle *v;
  (void)name; (void)place; (void)functions; (void)visible; (void)logging;
  if (type != 1 || !guid || strcmp(guid, GUID) != 0) return NULL;
  v = calloc(1, sizeof *v);
  if (v) fmi2Reset(v);
  return v;
}

API fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start, fmi2Boolean has_stop,
                                   fmi2Real stop) {
  (void)has_tolerance; (void)tolerance; (void)has_stop; (void)stop;
  ((Vehicle *)c)->t = start;
  return fmi2OK;
}
API fmi2Status fmi2EnterInitializationMode(fmi2Component c) { (void)c; return fmi2OK; }
API fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
  Vehicle *v = c;
  memcpy(v->x, v->start, sizeof v->x);
  return remember(v) ? fmi2OK : fmi2Error;
}
API fmi2Status fmi2Terminate(fmi2Component c) { (void)c; return fmi2OK; }

API fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference refs[], size_t n, fmi2Real values[]) {
  Vehicle *v = c;
  double y[N_Y];
  size_t i;
  if (!v->used && !remember(v)) return fmi2Error;
  measured(v, y);
  for (i = 0; i < n; ++i) {
    const unsigned r = refs[i];
    if (r < N_IN) values[i] = v->given[r];
    else if (r >= OUTPUT_REF && r < OUTPUT_REF + N_Y) values[i] = y[r - OUTPUT_REF];
    else if (r >= START_REF && r < START_REF + N_X) values[i] = v->start[r - START_REF];
    else return fmi2Error;
  }
  return fmi2OK;
}

API fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference refs[], size_t n, const fmi2Real values[]) {
  Vehicle *v = c;
  size_t i;
  for (i = 0; i < n; ++i) {
    const unsigned r = refs[i];
    if (r < N_IN) v->given[r] = values[i];
    else if (r >= START_REF && r < START_REF + N_X) v->start[r - START_REF] = v->x[r - START_REF] = values[i];
    else return fmi2Error;
  }
  return fmi2OK;
}

API fmi2Status fmi2DoStep(fmi2Component c, fmi2Real now, fmi2Real dt, fmi2Boolean final) {
  Vehicle *v = c;
  const double end = now + dt;
  double u[N_U], w[step_SZ_W + 1], next[N_X];
  const double *arg[step_SZ_ARG] = {0};
  double *res[step_SZ_RES] = {0};
  int iw[step_SZ_IW + 1], i;
  (void)final;
  v->t = now;
  if (!remember(v)) return fmi2Error;
  while (v->t < end - 1e-12) {
    const double until = in_force(v, v->t, end, u), whole = until - v->t;
    const int parts = (int)ceil(whole / MOST_STEP_S - 1e-9) > 1 ? (int)ceil(whole / MOST_STEP_S - 1e-9) : 1;
    const double h = whole / parts;
    for (i = 0; i < parts; ++i) {
      if (TIME_AT >= 0) u[TIME_AT < 0 ? 0 : TIME_AT] = v->t + (i + 0.5) * h;
      arg[0] = v->x;
      arg[1] = u;
      arg[2] = &h;
      res[0] = next;
      if (step(arg, res, iw, w, 0) != 0) return fmi2Error;
      memcpy(v->x, next, sizeof next);
    }
    v->t = until;
  }
  v->t = end;
  for (i = 0; i < N_X; ++i)
    if (!isfinite(v->x[i])) return fmi2Error;
  return fmi2OK;
}
API fmi2Status fmi2CancelStep(fmi2Component c) { (void)c; return fmi2Error; }

/* What the model has not: integers, booleans, strings, saved states, derivatives. */
#define NOTHING(name, type)                                                                                       \
  API fmi2Status fmi2Get##name(fmi2Component c, const fmi2ValueReference r[], size_t n, type v[]) {               \
    (void)c; (void)r; (void)v;                                                                                    \
    return n ? fmi2Error : fmi2OK;                                                                                \
  }                                                                                                               \
  API fmi2Status fmi2Set##name(fmi2Component c, const fmi2ValueReference r[], size_t n, const type v[]) {         \
    (void)c; (void)r; (void)v;                                                                                    \
    return n ? fmi2Error : fmi2OK;                                                                                \
  }
NOTHING(Integer, fmi2Integer)
NOTHING(Boolean, fmi2Boolean)
NOTHING(String, fmi2String)
API fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *s) { (void)c; (void)s; return fmi2Error; }
API fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate s) { (void)c; (void)s; return fmi2Error; }
API fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *s) { (void)c; (void)s; return fmi2Error; }
API fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate s, size_t *n) { (void)c; (void)s; (void)n; return fmi2Error; }
API fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate s, fmi2Byte b[], size_t n) {
  (void)c; (void)s; (void)b; (void)n;
  return fmi2Error;
}
API fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte b[], size_t n, fmi2FMUstate *s) {
  (void)c; (void)s; (void)b; (void)n;
  return fmi2Error;
}
API fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference z[], size_t nz, const fmi2ValueReference v[],
                                            size_t nv, const fmi2Real dv[], fmi2Real dz[]) {
  (void)c; (void)z; (void)nz; (void)v; (void)nv; (void)dv; (void)dz;
  return fmi2Error;
}
API fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer o[],
                                           const fmi2Real v[]) {
  (void)c; (void)r; (void)n; (void)o; (void)v;
  return fmi2Error;
}
API fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer o[], fmi2Real v[]) {
  (void)c; (void)r; (void)n; (void)o; (void)v;
  return fmi2Error;
}
#define STATUS(name, type)                                                       \
  API fmi2Status fmi2Get##name##Status(fmi2Component c, int kind, type *value) { \
    (void)c; (void)kind; (void)value;                                            \
    return fmi2Discard;                                                          \
  }
API fmi2Status fmi2GetStatus(fmi2Component c, int kind, fmi2Status *value) { (void)c; (void)kind; (void)value; return fmi2Discard; }
STATUS(Real, fmi2Real)
STATUS(Integer, fmi2Integer)
STATUS(Boolean, fmi2Boolean)
STATUS(String, fmi2String)
