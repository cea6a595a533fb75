// The passive engine plugin "carecontact.life": what a person does, as commands of the model's actuators. It breathes,
// changes its posture at given times, pulls the arm away from a force that hurts, and helps or holds when it is moved.
//
// It adds no force itself. In every forward pass it writes `ctrl` of the actuators that it owns, from the time, the joints
// and its own state, so that a state of mjSTATE_INTEGRATION continues bit for bit; at the end of a step it adds up work
// and watches the force on the arm. Kept in step with carecontact/kernel/life.py.
#pragma once
#include <mujoco/mujoco.h>

#define LIFE_PLUGIN "carecontact.life"

// Joints that muscles move, and parts of the trunk that breathing moves.
enum { LIFE_JOINTS = 4, LIFE_PARTS = 2, LIFE_PULLS = 3 };

// The state.
enum {
  LIFE_AWAKE = 0,   // 0 until Python wakes the person: then nothing moves
  LIFE_BEGAN,       // MjData.time at that moment [s]
  LIFE_POSTURE,     // LIFE_JOINTS: the joints' angles at that moment [rad]
  LIFE_BASE = LIFE_POSTURE + LIFE_JOINTS,  // LIFE_JOINTS: their angles when the present movement began [rad]
  LIFE_REST = LIFE_BASE + LIFE_JOINTS,     // LIFE_JOINTS: where the passive arm rested until then [rad]
  LIFE_WANT = LIFE_REST + LIFE_JOINTS,     // LIFE_JOINTS: where its muscles drew it until then [rad]
  LIFE_LIFTED = LIFE_WANT + LIFE_JOINTS,   // how far it was lifted off the board then [rad]
  LIFE_EFFORT,      // activation of the muscles then, 0 to 1
  LIFE_FROM,        // when that was, since LIFE_BEGAN [s]
  LIFE_NOW,         // the present movement: a row of "life/moves" from 1, 0 before the first, -1 for a withdrawal
  LIFE_ONSET,       // when it begins: its muscles tense before that [s]
  LIFE_MOVED,       // rows of "life/moves" whose time has come
  LIFE_OVER,        // how long the arm has borne too much without a break [s]
  LIFE_PULLED,      // withdrawals that were decided
  LIFE_DRAWN,       // withdrawals that have begun
  LIFE_PULL_TIME,   // LIFE_PULLS: when each begins, since LIFE_BEGAN [s]
  LIFE_WORK = LIFE_PULL_TIME + LIFE_PULLS,  // 2: of breathing and of the arm's muscles, since LIFE_BEGAN [J]
  LIFE_STATE = LIFE_WORK + 2
};

// The numeric "life/breath". A phase of 0 is the end of a breath out.
enum { BREATH_HZ, BREATH_IN_SHARE, BREATH_PHASE, BREATH_SIZE, BREATH_NUMBERS = BREATH_SIZE + LIFE_PARTS };

// The numeric "life/muscle": activation at rest, share of the passive joint that the person helps against.
enum { MUSCLE_TONE, MUSCLE_HELP, MUSCLE_NUMBERS };

// A row of the numeric "life/moves", the changes of posture in the order of their times; a row without duration is none.
enum { MOVE_TIME, MOVE_DURATION, MOVE_LIFT, MOVE_SHIFT, MOVE_SIZE = MOVE_SHIFT + LIFE_JOINTS };

// The numeric "life/withdrawal"; without a force there is none.
enum { PULL_FORCE, PULL_OVER, PULL_DELAY, PULL_DURATION, PULL_SHIFT, PULL_NUMBERS = PULL_SHIFT + LIFE_JOINTS };

// What registration.c gives to MuJoCo.
void life_plugin(mjpPlugin* plugin);
