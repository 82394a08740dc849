// What an extension module holds, whatever its instruction set.
#include <atomic>
#include <chrono>
#include <optional>
#include <thread>

#include "binding.hpp"

#if defined(__x86_64__) && defined(__GNUC__)
#include <cpuid.h>
#endif

namespace {

std::atomic<bool> python_ends = false;
std::atomic<int> unlocked_threads = 0;
std::thread::id ending_thread;

std::optional<liaam::EncodingConstants> constants_set;  // once, at import; only read later

constexpr std::chrono::milliseconds A_MOMENT{1};

// Whether this processor and its system run all that -march=x86-64-v3 may use. The processor is asked by hand: not every
// compiler that can build the extension knows this set, or each of its parts, by name.
bool runs_x86_64_v3() {
#if defined(__x86_64__) && defined(__GNUC__)
    constexpr unsigned kFma = 1u << 12, kMovbe = 1u << 22, kF16c = 1u << 29;  // leaf 1, ecx
    constexpr unsigned kBmi1 = 1u << 3, kBmi2 = 1u << 8;                      // leaf 7, ebx
    constexpr unsigned kLzcnt = 1u << 5;                                      // leaf 0x80000001, ecx
    const auto has = [](unsigned value, unsigned bits) { return (value & bits) == bits; };
    unsigned a = 0, b = 0, c = 0, d = 0;
    __builtin_cpu_init();
    if (!__builtin_cpu_supports("avx2")) return false;  // also that the system keeps the wide registers
    if (!__get_cpuid(1, &a, &b, &c, &d) || !has(c, kFma | kMovbe | kF16c)) return false;
    if (!__get_cpuid_count(7, 0, &a, &b, &c, &d) || !has(b, kBmi1 | kBmi2)) return false;
    return __get_cpuid(0x80000001, &a, &b, &c, &d) && has(c, kLzcnt);
#else
    return false;
#endif
}

void set_encoding_constants(const nb::dict& given) {
    const auto number = [&](const char* name) { return nb::cast<float>(given[name]); };
    const auto weights = [&](const char* name) { return nb::cast<std::array<float, 3>>(given[name]); };
    constants_set = {number("all"),      number("unusable"), number("log_floor"),  number("softness"),
                     number("flat"),     weights("brightness"), weights("luminance")};
}

}  // namespace

const liaam::EncodingConstants& encoding_constants() {
    require(constants_set.has_value(), "the constants of the encodings are not set; import liaam._core");
    return *constants_set;
}

Unlocked::Unlocked() {
    ++unlocked_threads;
    state_ = PyEval_SaveThread();
}

Unlocked::~Unlocked() {
    if (ending()) {
        --unlocked_threads;
        for (;;) std::this_thread::sleep_for(A_MOMENT);
    }
    PyEval_RestoreThread(state_);
    --unlocked_threads;
}

bool Unlocked::ending() { return python_ends && std::this_thread::get_id() != ending_thread; }

void Unlocked::end() {
    ending_thread = std::this_thread::get_id();
    python_ends = true;
    if (nb::cast<int>(nb::module_::import_("threading").attr("active_count")()) == 1) return;
    PyThreadState* state = PyEval_SaveThread();
    // Those that come back make their results yet, which takes less than the ten rounds without any.
    for (int rounds = 0, quiet = 0; quiet < 10 && rounds < 2000; ++rounds) {
        std::this_thread::sleep_for(A_MOMENT);
        quiet = unlocked_threads > 0 ? 0 : quiet + 1;
    }
    PyEval_RestoreThread(state);
}

void bind(nb::module_& module) {
    nb::set_leak_warnings(false);
    bind_level(module);
    bind_fit(module);
    bind_images(module);
    bind_parts(module);
    nb::module_::import_("atexit").attr("register")(nb::cpp_function(&Unlocked::end));
    module.def("_set_encoding_constants", set_encoding_constants, "constants"_a);
    module.def("best_instruction_set", [] { return runs_x86_64_v3() ? "avx2" : "baseline"; });
}
