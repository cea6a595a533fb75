#include "life.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "region.h"
#include "vec.h"

static const double PI = 3.14159265358979323846;
static const double RISE = 0.1, RELAX = 0.5;  // [s] in which muscles tense before a movement and let go after it
static const double PAUSE = 2.0;              // [s] between two withdrawals at least
static const double MARGIN = 0.087;           // [rad] no posture comes nearer to the end of a joint's range

static const char* PARTS[LIFE_PARTS] = {"abdomen", "chest"};
static const char* JOINTS[LIFE_JOINTS] = {"right_upper_arm_abduction", "right_upper_arm_flexion",
                                          "right_upper_arm_rotation", "right_forearm_flexion"};
enum { LIFTS = 1 };  // the joint that takes weight off the board
static const char* FELT[] = {"right_upper_arm", "right_forearm", "right_hand"};
enum { NFELT = 3 };

typedef struct {
  int breathes[LIFE_PARTS];                     // actuator, or -1 where the person does not breathe
  int joint[LIFE_JOINTS];                       // or -1 where the arm has no muscles
  int holds[LIFE_JOINTS], turns[LIFE_JOINTS];   // actuators: activation of the muscles, and torque
  int breath, muscle, moves, nmove, withdrawal; // addresses in numeric_data
  int sensor[NFELT], region[NFELT];             // address of the rigid surface's force; plugin instance or -1
} Life;

static Life* life_of(const mjData* d, int instance) { return (Life*)d->plugin_data[instance]; }

// From 0 to 1 while x does, by the fifth-order polynomial of the least jerk (Flash and Hogan 1985, J Neurosci 5:1688).
static double smooth(double x) { return x <= 0 ? 0 : x >= 1 ? 1 : x * x * x * (10 - x * (15 - 6 * x)); }

static int named(const mjModel* m, int type, const char* format, const char* name) {
  char full[128];
  snprintf(full, sizeof full, format, name);
  return mj_name2id(m, type, full);
}

static int numeric(const mjModel* m, const char* name, int size) {
  int id = named(m, mjOBJ_NUMERIC, "life/%s", name);
  if (id >= 0 && (size ? m->numeric_size[id] == size : m->numeric_size[id] % MOVE_SIZE == 0)) return id;
  mju_warning("carecontact.life: the model has no numeric life/%s of the right size", name);
  return -1;
}

// The instance of the soft region that lies on a body, or -1.
static int region_on(const mjModel* m, int body) {
  int instance = body < 0 ? -1 : m->body_plugin[body];
  return instance >= 0 && !strcmp(mjp_getPluginAtSlot(m->plugin[instance])->name, "carecontact.tissue") ? instance : -1;
}

// Its state, whose counts lie within the arrays; somebody may have written into it.
static double* state_in(const mjModel* m, const mjData* d, int instance) {
  double* state = d->plugin_state + m->plugin_stateadr[instance];
  const Life* l = life_of(d, instance);
  int sound = counts(state[LIFE_NOW] + 1, l->nmove + 2) && counts(state[LIFE_MOVED], l->nmove + 1) &&
              counts(state[LIFE_PULLED], LIFE_PULLS + 1) && counts(state[LIFE_DRAWN], LIFE_PULLS + 1);
  if (!sound) mju_error("carecontact.life: plugin_state was not written by it, or for another model");
  return state;
}

static int nstate(const mjModel* m, int instance) {
  (void)m, (void)instance;
  return LIFE_STATE;
}

static int init(const mjModel* m, mjData* d, int instance) {
  int breath = numeric(m, "breath", BREATH_NUMBERS), muscle = numeric(m, "muscle", MUSCLE_NUMBERS);
  int moves = numeric(m, "moves", 0), withdrawal = numeric(m, "withdrawal", PULL_NUMBERS);
  if (breath < 0 || muscle < 0 || moves < 0 || withdrawal < 0) return -1;
  Life* l = calloc(1, sizeof *l);
  if (!l) return -1;
  l->breath = m->numeric_adr[breath];
  l->muscle = m->numeric_adr[muscle];
  l->moves = m->numeric_adr[moves];
  l->nmove = m->numeric_size[moves] / MOVE_SIZE;
  l->withdrawal = m->numeric_adr[withdrawal];
  for (int k = 0; k < LIFE_PARTS; k++) l->breathes[k] = named(m, mjOBJ_ACTUATOR, "breathes_%s", PARTS[k]);
  for (int k = 0; k < LIFE_JOINTS; k++) {
    l->joint[k] = named(m, mjOBJ_JOINT, "human_%s", JOINTS[k]);
    l->holds[k] = named(m, mjOBJ_ACTUATOR, "holds_%s", JOINTS[k]);
    l->turns[k] = named(m, mjOBJ_ACTUATOR, "turns_%s", JOINTS[k]);
    if (l->holds[k] < 0 || l->turns[k] < 0) l->joint[k] = -1;
  }
  for (int k = 0; k < NFELT; k++) {
    int sensor = named(m, mjOBJ_SENSOR, "net_%s", FELT[k]);
    l->sensor[k] = sensor < 0 ? -1 : m->sensor_adr[sensor];
    l->region[k] = region_on(m, named(m, mjOBJ_BODY, "human_%s", FELT[k]));
  }
  d->plugin_data[instance] = (uintptr_t)l;
  return 0;
}

static void destroy(mjData* d, int instance) {
  free(life_of(d, instance));
  d->plugin_data[instance] = 0;
}

static void reset(const mjModel* m, mjtNum* state, void* data, int instance) {
  (void)m, (void)data, (void)instance;
  memset(state, 0, sizeof(double) * LIFE_STATE);
}

// How far out a part of the trunk is, from 0 at the end of a breath out to 1 at that of a breath in, and its rate [1/s].
static double breath(const double* x, double t, double* rate) {
  double cycle = x[BREATH_HZ] * t + x[BREATH_PHASE], in = x[BREATH_IN_SHARE];
  cycle -= floor(cycle);
  int inward = cycle < in;
  double share = inward ? in : 1 - in, at = PI * (inward ? cycle / in : 1 + (cycle - in) / share);
  *rate = sin(at) / 2 * PI * x[BREATH_HZ] / share;
  return (1 - cos(at)) / 2;
}

typedef struct {
  double want[LIFE_JOINTS];  // where the muscles draw the joints [rad]
  double rest[LIFE_JOINTS];  // where the passive joints rest [rad]
  double lifted;             // of which is to take the arm off its board [rad]
  double effort;             // activation of the muscles, 0 to 1
} Posture;


// The posture that the person wants now. A movement begins from where the arm lies, wherever it was pushed before, and
// ends the movement before it.
static Posture posture(const mjModel* m, const Life* l, const double* state, double t) {
  Posture p = {.effort = 0};
  memcpy(p.want, state + LIFE_WANT, sizeof p.want);
  memcpy(p.rest, state + LIFE_REST, sizeof p.rest);
  int now = (int)state[LIFE_NOW];
  if (now == 0) return p;
  const double *pull = m->numeric_data + l->withdrawal, *move = m->numeric_data + l->moves + MOVE_SIZE * (now - 1);
  const double* shift = now < 0 ? pull + PULL_SHIFT : move + MOVE_SHIFT;
  double duration = now < 0 ? pull[PULL_DURATION] : move[MOVE_DURATION], lift = now < 0 ? 0 : move[MOVE_LIFT];
  double part = (t - state[LIFE_ONSET]) / duration, tensed = smooth((t - state[LIFE_FROM]) / RISE);
  // The arm is lighter from before it moves along the board until it has arrived.
  p.lifted = lift * smooth(part / 0.3) * (1 - smooth((part - 0.7) / 0.3)) + state[LIFE_LIFTED] * (1 - smooth(part));
  p.effort = state[LIFE_EFFORT] + (1 - state[LIFE_EFFORT]) * tensed;
  p.effort *= 1 - smooth((part - 1) * duration / RELAX);
  for (int k = 0; k < LIFE_JOINTS; k++) {
    if (l->joint[k] < 0) continue;
    const double *range = m->jnt_range + 2 * l->joint[k], base = state[LIFE_BASE + k];
    double low = least(range[0] + MARGIN, base), high = most(range[1] - MARGIN, base);
    double to = base + shift[k] * smooth((part - 0.15) / 0.7) + (k == LIFTS ? p.lifted : 0);
    double moved = least(most(to, low), high) - base;
    p.want[k] += tensed * (base - p.want[k]) + moved;
    p.rest[k] += tensed * (base - p.rest[k]) + moved;
  }
  return p;
}

// Begins a movement. The muscles let go of the posture before it while they tense for this one.
static void begin(const mjModel* m, const mjData* d, const Life* l, double* state, double t, int now, double onset) {
  Posture p = posture(m, l, state, t);
  for (int k = 0; k < LIFE_JOINTS; k++) {
    if (l->joint[k] < 0) continue;
    double at = d->qpos[m->jnt_qposadr[l->joint[k]]];
    double lifted = k == LIFTS ? p.lifted : 0;
    state[LIFE_BASE + k] = at - lifted;
    state[LIFE_REST + k] = p.rest[k] - lifted;
    // Muscles that were slack drew nowhere.
    state[LIFE_WANT + k] = at + p.effort * (p.want[k] - at) - lifted;
  }
  state[LIFE_LIFTED] = p.lifted;
  state[LIFE_EFFORT] = p.effort;
  state[LIFE_FROM] = t;
  state[LIFE_NOW] = now;
  state[LIFE_ONSET] = onset;
}

// Begins what is due. Nobody changes the posture while a withdrawal is under way.
static void begin_due(const mjModel* m, const mjData* d, const Life* l, double* state, double t) {
  const double *moves = m->numeric_data + l->moves, *pull = m->numeric_data + l->withdrawal;
  int pulled = (int)state[LIFE_PULLED], drawn = (int)state[LIFE_DRAWN];
  if (drawn < pulled && t >= state[LIFE_PULL_TIME + drawn] - RISE) {
    begin(m, d, l, state, t, -1, state[LIFE_PULL_TIME + drawn]);
    state[LIFE_DRAWN] += 1;
  }
  int moved = (int)state[LIFE_MOVED];
  const double* move = moves + MOVE_SIZE * moved;
  if (moved == l->nmove || move[MOVE_DURATION] <= 0 || t < move[MOVE_TIME] - RISE) return;
  state[LIFE_MOVED] += 1;
  if (pulled && t < state[LIFE_PULL_TIME + pulled - 1] + pull[PULL_DURATION]) return;
  begin(m, d, l, state, t, moved + 1, move[MOVE_TIME]);
}

static void tense(const mjModel* m, mjData* d, const Life* l, const double* state, double t) {
  const double* muscle = m->numeric_data + l->muscle;
  Posture p = posture(m, l, state, t);
  double tone = muscle[MUSCLE_TONE], effort = (1 - tone) * p.effort;
  for (int k = 0; k < LIFE_JOINTS; k++) {
    int j = l->joint[k];
    if (j < 0) continue;
    double stiffness = -m->actuator_gainprm[mjNGAIN * l->holds[k] + 1], passive = m->jnt_stiffness[j];
    double away = d->qpos[m->jnt_qposadr[j]] - p.rest[k], speed = d->qvel[m->jnt_dofadr[j]];
    double damping = m->dof_damping[m->jnt_dofadr[j]];
    d->ctrl[l->holds[k]] = tone + effort;
    // The set points of muscles and of their tone; the passive spring, which rests at the new posture; and help.
    d->ctrl[l->turns[k]] = stiffness * (effort * p.want[k] + tone * p.rest[k]) +
                           passive * (p.rest[k] - state[LIFE_POSTURE + k]) +
                           muscle[MUSCLE_HELP] * (passive * away + damping * speed);
  }
}

static void compute(const mjModel* m, mjData* d, int instance, int capability) {
  (void)capability;
  const Life* l = life_of(d, instance);
  const double *state = state_in(m, d, instance), *x = m->numeric_data + l->breath;
  int awake = state[LIFE_AWAKE] != 0;
  double t = d->time - state[LIFE_BEGAN], rate, out = breath(x, t, &rate);
  for (int k = 0; k < LIFE_PARTS; k++) {
    int a = l->breathes[k];
    if (a < 0) continue;
    const double* bias = m->actuator_biasprm + mjNBIAS * a;
    // The damper's part is added, so that the servo does not lag.
    d->ctrl[a] = awake ? x[BREATH_SIZE + k] * (out + rate * bias[2] / bias[1]) : 0;
  }
  if (awake) tense(m, d, l, state, t);
  else
    for (int k = 0; k < LIFE_JOINTS; k++)
      if (l->joint[k] >= 0) d->ctrl[l->holds[k]] = d->ctrl[l->turns[k]] = 0;
}

// The largest force on a part of the arm in the step that ends [N].
static double felt(const mjData* d, const Life* l) {
  double largest = 0;
  for (int k = 0; k < NFELT; k++) {
    double force[3] = {0, 0, 0};
    if (l->sensor[k] >= 0) memcpy(force, d->sensordata + l->sensor[k], sizeof force);
    if (l->region[k] >= 0) {
      const Region* r = (const Region*)d->plugin_data[l->region[k]];
      for (int j = 0; j < 3; j++) force[j] += r->row[ROW_FORCE + j];
    }
    largest = most(largest, dot(force, force));
  }
  return sqrt(largest);
}

static void watch(const mjModel* m, const mjData* d, const Life* l, double* state, double t) {
  const double* pull = m->numeric_data + l->withdrawal;
  int count = (int)state[LIFE_PULLED];
  if (pull[PULL_FORCE] <= 0) return;
  state[LIFE_OVER] = felt(d, l) > pull[PULL_FORCE] ? state[LIFE_OVER] + m->opt.timestep : 0;
  if (state[LIFE_OVER] < pull[PULL_OVER] || count == LIFE_PULLS) return;
  if (count && t < state[LIFE_PULL_TIME + count - 1] + PAUSE) return;
  state[LIFE_PULL_TIME + count] = t + pull[PULL_DELAY];
  state[LIFE_PULLED] += 1;
}

// Positions and time are those at the end of the step, forces those during it.
static void advance(const mjModel* m, mjData* d, int instance) {
  const Life* l = life_of(d, instance);
  double* state = state_in(m, d, instance);
  if (state[LIFE_AWAKE] == 0) return;
  for (int k = 0; k < LIFE_PARTS; k++)
    if (l->breathes[k] >= 0) {
      int dof = m->jnt_dofadr[m->actuator_trnid[2 * l->breathes[k]]];
      state[LIFE_WORK] += d->actuator_force[l->breathes[k]] * d->qvel[dof] * m->opt.timestep;
    }
  for (int k = 0; k < LIFE_JOINTS; k++)
    if (l->joint[k] >= 0) {
      double torque = d->actuator_force[l->holds[k]] + d->actuator_force[l->turns[k]];
      state[LIFE_WORK + 1] += torque * d->qvel[m->jnt_dofadr[l->joint[k]]] * m->opt.timestep;
    }
  double t = d->time - state[LIFE_BEGAN];
  watch(m, d, l, state, t);
  begin_due(m, d, l, state, t);
}

void life_plugin(mjpPlugin* plugin) {
  plugin->name = LIFE_PLUGIN;
  plugin->capabilityflags = mjPLUGIN_PASSIVE;
  plugin->nstate = nstate;
  plugin->init = init;
  plugin->destroy = destroy;
  plugin->reset = reset;
  plugin->compute = compute;
  plugin->advance = advance;
}
