// The passive engine plugin "carecontact.tissue": soft regions of the body that push on bones and tools.
#pragma once
#include <mujoco/mujoco.h>

#define TISSUE_PLUGIN "carecontact.tissue"

// What registration.c gives to MuJoCo. Writes every field of the description that the plugin uses.
void tissue_plugin(mjpPlugin* plugin);
