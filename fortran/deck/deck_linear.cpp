// Linear problems: what their tables may hold, and what must fit together.
#include "deck.h"

#include <cmath>

namespace rk {

// Without [linear] nothing may be there that only linear problems have
static void check_without(Deck &deck) {
   if (const Section *dynamics = deck.single("dynamics"))
      deck.refuse(*dynamics, "", "only for linear problems: [linear] is missing");
   for (Section *pin : deck.entries("pin"))
      deck.refuse(*pin, "", "only for linear problems");
   for (Section *boundary : deck.entries("boundary")) {
      for (const char *key : {"u", "flux"}) {
         if (boundary->find(key))
            deck.refuse(*boundary, key, "only for linear problems with problem = poisson");
      }
   }
   if (deck.dimension() == 1)
      deck.refuse(*deck.single("scene"), "dimension",
                  "1 is only for linear problems: the table [linear] is missing");
}

// Keys of the operator, one value for each unknown
static void check_values(Deck &deck, const Section &linear) {
   const int dimension = deck.dimension();
   const std::string problem = linear.text("problem");
   const bool scalar = problem == "poisson";
   for (Section *boundary : deck.entries("boundary")) {
      for (const auto &[key, value] : boundary->values) {
         const bool fits = key == "set" || (scalar ? is_one_of(key, {"u", "flux"})
                                                   : is_one_of(key, {"u_x", "u_y", "u_z", "traction"}));
         if (!fits)
            deck.refuse(*boundary, key,
                        "is not known in a linear problem of " + problem + "; it has " +
                            (scalar          ? "u and flux"
                             : dimension < 2 ? "u_x and traction"
                                             : "u_x, u_y and traction"));
      }
   }
   const auto fields = static_cast<std::size_t>(scalar ? 1 : dimension);
   for (const Section *section : {&linear, deck.single("dynamics")}) {
      for (const char *key : {"source", "exact", "velocity"}) {
         const Value *value = section ? section->find(key) : nullptr;
         if (value && value->items.size() != fields && dimension > 0)
            deck.refuse(*section, key,
                        "must have " + std::to_string(fields) + " item" +
                            (fields == 1 ? "" : "s") + ", one for each unknown, not " +
                            std::to_string(value->items.size()));
      }
   }
   if (const Section *dynamics = deck.single("dynamics")) {
      const Value *step = dynamics->find("time_step"), *end = dynamics->find("end_time");
      const double steps = step && end ? end->number() / step->number() : 1.0;
      if (std::round(steps) < 1.0 || std::abs(steps - std::round(steps)) > 1e-6 * steps)
         deck.refuse(*dynamics, "end_time",
                     "must be a whole number of time steps of " + step->plain() + ", not " +
                         end->plain());
   }
}

static void check_linear_probes(Deck &deck, const Section &linear, const std::string &method) {
   const std::string problem = linear.text("problem");
   // collocation knows forces from virtual work, which does not know sources and inertia
   const bool forces =
       method == "rkpm-gauss" || (!linear.find("source") && !deck.single("dynamics"));
   for (Section *probe : deck.entries("probe")) {
      const std::string quantity = probe->text("quantity");
      const bool force = quantity.compare(0, 5, "force") == 0;
      const bool moved = quantity.compare(0, 6, "torque") == 0 ||
                         quantity.compare(0, 7, "section") == 0 || probe->find("set") ||
                         of_whole_body(quantity);
      const bool fits = problem == "poisson" ? quantity == "u" && !moved
                        : force              ? forces
                                             : quantity != "J" && !moved;
      if (!quantity.empty() && !fits)
         deck.refuse(*probe, "quantity",
                     quantity + (moved && !force && !of_whole_body(quantity)
                                     ? " of a set or section"
                                     : "") +
                         " is not known in a linear problem of " + problem + " by " + method +
                         (force && !forces && problem != "poisson"
                             ? ", whose virtual work has no sources and no inertia: use "
                               "scene.method = rkpm-gauss"
                             : ""));
   }
}

void check_linear(Deck &deck) {
   const Section *linear = deck.single("linear");
   if (!linear) {
      check_without(deck);
      return;
   }
   for (const char *table : {"material", "amplitude", "exact", "reference"}) {
      for (Section *section : deck.entries(table))
         deck.refuse(*section, "", "is not used by a linear problem, which [linear] defines");
   }
   const std::string body = deck.word("geometry", "kind"), method = deck.word("scene", "method");
   if (!body.empty() && body != "box")
      deck.refuse(*deck.single("geometry"), "kind", "must be box for a linear problem, not " + body);
   if (!method.empty() && method != "rkcm" && method != "rkpm-gauss")
      deck.refuse(*deck.single("scene"), "method",
                  "must be rkpm-gauss or rkcm for a linear problem, not " + method);
   check_values(deck, *linear);
   check_linear_probes(deck, *linear, method);
}

} // namespace rk
