// Registers the plugins with MuJoCo when the library is loaded, and says what was built.
#include "export.h"
#include "life.h"
#include "plugin.h"

// Platform, sha256 of the sources and MuJoCo's version; the build defines it.
EXPORT const char* carecontact_kernel_version(void) { return CARECONTACT_KERNEL_MARK; }

static int registered = 0;

// Whether this library supplied the plugins. It does not where MuJoCo has another version, whose structures would be
// read wrongly, and where another library has taken a name: MuJoCo would end the process.
EXPORT int carecontact_kernel_registered(void) { return registered; }

mjPLUGIN_LIB_INIT(carecontact_kernel) {
  if (mj_version() != mjVERSION_HEADER) return;
  if (mjp_getPlugin(TISSUE_PLUGIN, NULL) || mjp_getPlugin(LIFE_PLUGIN, NULL)) return;
  mjpPlugin plugin;
  mjp_defaultPlugin(&plugin);
  tissue_plugin(&plugin);
  registered = mjp_registerPlugin(&plugin) >= 0;
  mjp_defaultPlugin(&plugin);
  life_plugin(&plugin);
  registered &= mjp_registerPlugin(&plugin) >= 0;
}
