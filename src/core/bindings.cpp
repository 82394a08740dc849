// The extension module.
#include "binding.hpp"

NB_MODULE(LIAAM_MODULE, module) {
    nb::set_leak_warnings(false);
    bind_level(module);
    bind_fit(module);
    bind_images(module);
    bind_parts(module);
    module.attr("SOURCES") = LIAAM_DIGEST;
    module.def("best_instruction_set", [] {
#if defined(__x86_64__) && defined(__GNUC__)
        __builtin_cpu_init();
        return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") ? "avx2" : "baseline";
#else
        return "baseline";
#endif
    });
}
