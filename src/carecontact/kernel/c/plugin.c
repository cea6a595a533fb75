#include "plugin.h"

static int state_size(const mjModel* model, int instance) {
  (void)model, (void)instance;
  return 0;
}

static int init(const mjModel* model, mjData* data, int instance) {
  (void)model;
  data->plugin_data[instance] = 0;
  return 0;
}

static void destroy(mjData* data, int instance) { data->plugin_data[instance] = 0; }

static void reset(const mjModel* model, mjtNum* state, void* plugin_data, int instance) {
  (void)model, (void)state, (void)plugin_data, (void)instance;
}

static void compute(const mjModel* model, mjData* data, int instance, int capability) {
  (void)model, (void)data, (void)instance, (void)capability;
}

static void advance(const mjModel* model, mjData* data, int instance) {
  (void)model, (void)data, (void)instance;
}

void tissue_plugin(mjpPlugin* plugin) {
  plugin->name = TISSUE_PLUGIN;
  plugin->capabilityflags = mjPLUGIN_PASSIVE;
  plugin->nstate = state_size;
  plugin->init = init;
  plugin->destroy = destroy;
  plugin->reset = reset;
  plugin->compute = compute;
  plugin->advance = advance;
}
