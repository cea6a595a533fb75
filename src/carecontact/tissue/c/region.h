// One soft region: its mesh, its law, its state, and the step that is being made.
//
// Everything is in the frame of the bone that carries the region. A vertex has three unknowns: u[0] along its inward
// normal, u[1] and u[2] along its two tangents [m]. A contact point lies in a triangle of vertices and moves with them.
#pragma once
#include <mujoco/mujoco.h>

#include "tool.h"
#include "vec.h"

enum { RING_ROWS = 64 };

static const double STILL = 1e-7;  // [m], [m/s] a vertex below both is at rest

// A row of the ring: what the region felt in one physics step. Kept in step with carecontact/kernel/readings.py.
enum {
  ROW_FORCE = 0,      // 3: on the person, world [N]
  ROW_NORMAL = 3,     // sum over contact points of the force along the tool's normal [N]
  ROW_CENTROID = 4,   // 3: of pressure, world [m]; 0 without contact
  ROW_DEPTH = 7,      // largest indentation of a vertex [m]
  ROW_PRESSURE = 8,   // largest pressure [Pa]
  ROW_AREA = 9,       // in contact [m^2]
  ROW_POINTS = 10,    // contact points
  ROW_SWEEPS = 11,    // of the solver
  ROW_LEFT = 12,      // largest change in the last sweep [m]; mjMAXVAL where the step was not solved
  // The energy of the step, where the option asks for it [J]:
  ROW_STORED = 13,    // in anchors, coupling, membrane and contact layer, at its end
  ROW_KINETIC = 14,   // of the shell, at its end
  ROW_DAMPED = 15,    // lost in the anchors' dampers during it
  ROW_RUBBED = 16,    // lost to friction during it
  // What of the force is not the tip's but of the robot's hand, and then of its links:
  ROW_BESIDE_FORCE = 17,   // 3 each: on the person, world [N]
  ROW_BESIDE_NORMAL = 23,  // 1 each: sum over their contact points of the force along their normal [N]
  ROW_SIZE = 25
};

// What each declared cell of the surface has felt since the state was last reset; sums over steps.
enum {
  CELL_PRESS = 0,  // normal force times time [N s]
  CELL_SHEAR = 1,  // size of the friction force times time [N s]
  CELL_SLIP = 2,   // slipped distance times area [m^3]
  CELL_TOUCH = 3,  // area in contact times time [m^2 s]
  CELL_SIZE = 4
};

// The numeric "<key>/law", read anew in every step, so that a law can be changed in a compiled model.
enum { LAW_A, LAW_B, LAW_C, LAW_DAMPING, LAW_DAMPING_GROWTH, LAW_MASS, LAW_COUPLING, LAW_MEMBRANE, LAW_FRICTION,
       LAW_CONTACT, LAW_THICKNESS, LAW_SIZE };

// The numeric "<key>/contact" (LAYER_M, ENTRY_M and LOCK in kernel/region.py). Where a region has none, all are 0.
enum { CONTACT_LAYER, CONTACT_ENTRY, CONTACT_LOCK, CONTACT_SIZE };

// The numeric "<key>/options".
enum { OPTION_REACH, OPTION_TOLERANCE, OPTION_SWEEPS, OPTION_LEDGER, OPTION_SIZE };

// Columns of the numerics "<key>/vertices", "<key>/edges" and "<key>/triangles".
enum { VERTEX_PLACE = 0, VERTEX_INWARD = 3, VERTEX_ALONG = 6, VERTEX_ACROSS = 9, VERTEX_AREA = 12, VERTEX_SIZE = 13 };
enum { EDGE_FROM, EDGE_TO, EDGE_WEIGHT, EDGE_SIZE };
enum { TRIANGLE_CORNER = 0, TRIANGLE_AREA = 3, TRIANGLE_CELL = 4, TRIANGLE_SIZE = 5 };

// Contact points of a triangle: the first, in its middle, meets round tools; the others, of a third of the area each,
// meet tools with faces, on whose rims a whole triangle would turn over at once. Where both meet one triangle, each third
// of its area bears on one of them only.
enum { POINTS_EACH = 4 };

// Tissue of a limb that is pressed to more than this share of its thickness locks (docs/evidence/tissue.md): at w over that depth,
// the rest of the thickness being h, its pressure is higher by LOCK a h (w / h)^3. Kept in step with
// carecontact/kernel/region.py.
static const double LOCK_FROM = 0.6;

// Tissue that does not lock grows firmer across where it is pressed to more than this share of its thickness, over the next
// FIRMS_OVER of it, and at least THINNEST of it counts as left (docs/evidence/tissue.md). Kept in step with
// carecontact/kernel/region.py.
static const double FIRM_FROM = 0.5, FIRMS_OVER = 0.1, THINNEST = 0.2;

// All of them are doubles, which law_sound adds up.
typedef struct {
  double a, b, c, damping, damping_growth, mass, coupling, membrane, friction, contact, thickness;
  double lock, locks_at;  // LOCK a / h^2 [N/m^5], and the depth from which the tissue locks [m]
  double firms_at;        // the depth from which it grows firmer across: mjMAXVAL where it locks [m]
  double layer, entry;    // depth over which the contact layer stiffens, way over which skin is let in [m]
} Law;

typedef struct {
  double place[3], frame[9];  // rows of frame: inward normal and the two tangents
  double area, weight;        // weight: sum over its edges
  double span;                // length of its longest edge [m]
  int edge, edges;            // its stretch of neighbour and neighbour_weight
  int use, uses;              // its stretch of live_contact and live_corner
} Vertex;

typedef struct {
  int corner[3], cell;
  int third;             // whether it meets tools with faces, and not round ones
  double share[3], area;
  double place[3], offset[3][3];  // undeformed; of the corners from it
  double inward[3];      // unit, of the undeformed surface
} Point;

// Neighbouring vertices, of which a tool that is far from all is not asked one by one.
typedef struct {
  double middle[3], radius;
  double span;       // largest of its vertices [m]
  int first, count;  // its stretch of in_patch
} Patch;

// What a vertex does in a step: nothing; it may move; a point that it carries may touch.
enum { AWAY, MOVES, CLOSE };

// The linear part of a vertex's balance of forces in a step [N/m], and what of it does not depend on where it goes [N].
typedef struct {
  double pull[3], normal, tangential, over;
} Balance;

// A contact point near a tool during the step that is being made.
typedef struct {
  int point, tool, touching;
  double area;           // that it bears for [m^2]
  double at[3];          // where it was at the start of the step
  double normal[3];      // of the tool, outward
  // How far the point is from bearing, negative where the layer is pressed: its distance to the tool, negative inside, plus
  // `stands_off` and `allowed`; continued from `seen` to the start of the step as if the tool were flat [m].
  double gap;
  double stands_off;     // how far the point stands off a round tool [m]
  double allowed;        // its allowance at the step's end: depth in the tool that is not in the layer (entry.c) [m]
  double bristle[3];     // the bend of its bristle, along the tool's surface (entry.c) [m]
  double drag[3];        // the fall of the allowance over the tool's way, along the bristle
  double seen[3];        // how far it had moved where the gap was measured [m]
  double traction[3];    // friction per area now [Pa]
  int stayed;            // whether it touched in the step before
  double before[3];      // its friction per area then [Pa]
  double held[3];        // the same, turned onto the tool's tangent plane [Pa]
  double depth_before, allowed_before;         // depth in the tool and allowance then [m]
  double normal_before[3], bristle_before[3];  // the tool's normal and the bristle's bend then; 0 at a new point
  double layer;          // depth at which the layer's pressure is twice as high as a linear layer's [m]; 0: it is linear
  double stiff;          // of the layer between skin and tool: the skin's and the tool's own, one after the other [N/m^3]
  double shift[3];       // how far the tool's material moved past it in the last step [m]
  double local[3][3];    // the normal in the frame of each corner
  double moved[3];       // since the start of the step [m]
  double pressure;       // [Pa]
  double slipped;        // [m]
  double touched;        // area that touches the tool: the part of it that lies within the rim, for a round tool [m^2]
} Contact;

// What a vertex near a tool sees of the rim of the contact.
typedef struct {
  int known, met, past;  // met: how many of its triangles touch; past: whether it lies past the rim
  double toward[3];      // unit, along the skin from the rim to the vertex
  double far;            // distance to the rim [m]
} Rim;

typedef struct {
  // Read-only after region_init.
  int nvertex, npoint, ncell, ntool, bone, law_address, option_address;
  int contact_address;  // of "<key>/contact", or -1
  int held_size;        // numbers in a row of the state's friction
  Vertex* vertex;
  Point* point;
  int* first_corner;        // (npoint / POINTS_EACH) of each triangle, side by side for the search
  Tool* tool;
  int* neighbour;
  double* neighbour_weight;
  double middle[3], bound;  // a sphere that holds the region
  float *px, *py, *pz;      // places again, for the search
  int npatch, *in_patch;    // all vertices, patch by patch
  Patch* patch;

  // Of the step that is being made; committed by region_commit.
  int ready;                 // region_step ran since the last commit
  int nwindow, ncontact;
  int* window;               // vertices that may move, in their order
  int* live;  // (nvertex) how many contacts a vertex carries
  int *live_contact, *live_corner;  // which, and which of their corners it is
  int* held_of;              // (npoint) a point's row in the state's friction, or -1; used while contacts are found
  unsigned char *moves, *hit;  // (nvertex) AWAY, MOVES or CLOSE; near the tool that is looked at
  Contact* contact;
  Rim* rim;  // (nvertex)
  double *u, *rate;         // (nvertex, 3)
  Balance* balance;
  double row[ROW_SIZE];
  double* force;            // (nv) generalised force of the step
  int nv;
} Region;

// Where things lie in a region's plugin_state. `holds` is the number of points that touched in the last step, and `held`
// has a row for each: its number and its friction per area, and in a region that lets skin in also its depth in the tool,
// its allowance, the tool's normal and the bend of its bristle.
typedef struct {
  double *steps, *awake, *u, *rate, *holds, *held, *cells, *ring;
} State;

// The state has room for HELD_SIZE numbers for every point. Longer rows share this room: no shipped tool touches a
// third of a region's points at once. Where one does, the points that find no room count as new in each step, and ROW_LEFT
// says so.
enum { HELD_SIZE = 4, HELD_LONG = 12 };

int state_size(int nvertex, int ntriangle, int ncell);
State state_of(const Region* r, double* state);
// Whether its counts and numbers lie within the arrays; somebody may have written into the state.
int state_sound(const Region* r, const State* s);

int region_init(const mjModel* m, int instance, Region* r);  // 0, or -1 after mju_warning
void region_free(Region* r);
void region_copy(Region* to, const Region* from);
void region_step(const mjModel* m, mjData* d, Region* r, const State* s);
void region_commit(Region* r, State* s, double dt);

// The parts of a step, one file each.
Law law_read(const mjModel* m, const Region* r);
// Whether a step can be made with these numbers: all are finite, and neither layer nor entry is negative.
int law_sound(const Law* law);
void patches_make(Region* r);
void window_find(const mjModel* m, const mjData* d, Region* r, const State* s, double reach);
// Adds a contact to those of the step, and to its three vertices'; forgets all.
void contact_keep(Region* r, const Contact* c);
void contact_forget(Region* r);
void contact_find(Region* r, const State* s, const Law* law, double dt);
// Takes a point's allowance off its depth (entry.c). `exact`: whether its gap is a distance, and not one to a plane.
void entry_allow(const Law* law, Contact* c, int exact);
// Turns a point's friction with the tool's surface, so that it keeps its size and with it the energy that it holds.
void entry_turn(Contact* c);
// Measures anew the gaps of points that end far from where they were expected; returns whether there were any.
int contact_review(Region* r, const Law* law);
void solve(Region* r, const State* s, const Law* law, double dt, double tolerance, int sweeps);
// How much of each contact's area touches.
void rim_find(Region* r, const Law* law);
void wrench_apply(const mjModel* m, mjData* d, Region* r, int lets_in);
void ledger(Region* r, const State* s, const Law* law);

// Hardly any vertex is pressed so deep that it locks, and skin that is pulled outward never does: a branch is cheaper than
// the term.
static inline double law_pressure(const Law* law, double x) {
  double size = x < 0 ? -x : x, over = x - law->locks_at, pressure = x * (law->a + size * (law->b + size * law->c));
  return over > 0 ? pressure + law->lock * over * over * over : pressure;
}

static inline double law_tangent(const Law* law, double x) {
  double size = x < 0 ? -x : x, over = x - law->locks_at, tangent = law->a + size * (2 * law->b + 3 * size * law->c);
  return over > 0 ? tangent + 3 * law->lock * over * over : tangent;
}

// [J/m^2]
static inline double law_energy(const Law* law, double x) {
  double size = x < 0 ? -x : x, over = x - law->locks_at;
  double energy = x * x * (law->a / 2 + size * (law->b / 3 + size * law->c / 4));
  return over > 0 ? energy + law->lock * over * over * over * over / 4 : energy;
}

// What the stiffness across has grown by beyond a [N/m^3], and how fast it grows with the depth. Hardly any vertex is
// pressed so deep.
static inline double law_firmer(const Law* law, double x, double* grows) {
  double over = x - law->firms_at;
  *grows = 0;
  if (over <= 0) return 0;
  double from = x - over, secant = law_pressure(law, x) / x, more = secant - law_pressure(law, from) / from;
  double left = most(THINNEST, 1 - x / law->thickness), soft = FIRMS_OVER * law->thickness, in = over / (over + soft);
  *grows = ((law_tangent(law, x) - secant) / x * in + more * soft / ((over + soft) * (over + soft))) / left;
  if (left > THINNEST) *grows += more * in / (law->thickness * left * left);
  return more * in / left;
}

static inline double law_damping(const Law* law, double x) { return law->damping + (x > 0 ? law->damping_growth * x : 0); }
