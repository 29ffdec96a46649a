// Rules that the schema cannot express and that can be checked without points. Rules about derived
// values, and all that need points, are checked in Fortran (solve/).
#include "deck.h"
#include "expression.h"

#include <algorithm>
#include <cmath>
#include <set>

namespace rk {

static void check_materials(Deck &deck) {
   const std::vector<Section *> materials = deck.entries("material");
   const bool regions = std::any_of(materials.begin(), materials.end(), [](Section *material) {
      return material->given("where");
   });
   const bool labelled = deck.word("geometry", "kind") == "model";
   for (Section *material : materials) {
      const Value *label = material->find("label");
      const bool where = material->given("where");
      if (regions && label)
         deck.refuse(*material, "label",
                     "cannot be given where materials are placed by `where`: only a model has labels");
      const bool given = material->given("label"), alone = materials.size() == 1;
      if ((regions || !(labelled || alone || given)) && material != materials.front() && !where)
         deck.refuse(*material, "where",
                     "missing: only the first material may omit it and fill the rest");
      if (!regions && labelled && !alone && !given)
         deck.refuse(*material, "label", "missing: an integer is needed where there are several materials");
   }
}

// The motion of the plate at the end of a tendon is not prescribed by another key
static void check_tendon(Deck &deck, Section &section) {
   for (const char *load : {"spring", "pressure"})
      if (section.find("tendon") && section.find(load))
         deck.refuse(section, load, "cannot act on the plate of a tendon: give it a pull instead");
   const Value *direction = section.find("tendon") ? section.find("direction") : nullptr;
   if (!direction)
      return;
   const char *component[] = {"u_x", "u_y", "u_z"};
   for (std::size_t i = 0; i < std::min<std::size_t>(direction->items.size(), 3); ++i) {
      const Value *held = section.find(component[i]);
      if (held && direction->items[i].number() != 0.0)
         deck.refuse(section, component[i],
                     "cannot be combined with a tendon whose direction has a component along it");
   }
}

static void check_boundary(Deck &deck) {
   for (Section *section : deck.entries("boundary")) {
      const Value *amplitude = section->find("amplitude");
      const bool stiff = section->find("spring") || section->find("tendon");
      const bool driven = std::any_of(
         section->values.begin(), section->values.end(), [](const auto &entry) {
            static const std::set<std::string> still = {"set", "amplitude", "spring", "tendon",
                                                        "direction", "axis", "about"};
            return still.count(entry.first) == 0;
         });
      if (amplitude && stiff && !driven)
         deck.refuse(*section, "amplitude",
                     "nothing here varies with it: the stiffness of a spring or tendon is constant; move "
                     "its other end by a traction beside the spring, or by the pull of the tendon");
      check_tendon(deck, *section);
   }
}

// An amplitude starts at load time 0
static void check_amplitudes(Deck &deck) {
   for (Section *amplitude : deck.entries("amplitude")) {
      const Value *time = amplitude->find("time");
      if (time && time->items.front().number() != 0.0)
         deck.refuse(*amplitude, "time", "must start at 0, not " + time->items.front().plain());
   }
}

// A quantity of a body or a material, not of a position
static bool of_whole_body(const std::string &quantity) {
   return quantity == "energy" || quantity == "fiber_stretch" || quantity == "pennation";
}

static void check_probes(Deck &deck) {
   const std::string method = deck.word("scene", "method");
   const bool weak = method.compare(0, 4, "rkpm") == 0, linear = deck.single("linear");
   // collocation computes forces from virtual work, which lacks sources and inertia
   const bool lacks_work =
      linear && method == "rkcm" && (deck.value("linear", "source") || deck.single("dynamics"));
   for (Section *probe : deck.entries("probe")) {
      const std::string quantity = probe->text("quantity");
      const Value *material = probe->find("material");
      const bool whole = of_whole_body(quantity);
      const bool force = quantity.compare(0, 5, "force") == 0;
      const bool of_set = force || quantity.compare(0, 6, "torque") == 0;
      if (!whole && !of_set && !probe->given("point") && !probe->given("set"))
         deck.refuse(*probe, "", "needs one of the keys point, set");
      if (whole && probe->find("point"))
         deck.refuse(*probe, "point", "cannot be given for " + quantity + ", a quantity of the whole body");
      if (linear && !force && probe->find("set"))
         deck.refuse(*probe, "set", "the mean displacement of a set is not known in a linear problem: give a point");
      if (force && lacks_work)
         deck.refuse(*probe, "quantity",
                     quantity + " is not known by rkcm, whose virtual work has no sources and no "
                                "inertia: use scene.method = rkpm-gauss");
      if (material && !whole && !weak)
         deck.refuse(*probe, "material",
                     "the force of one material needs a Galerkin form, such as scene.method = rkpm-gauss");
   }
}

// Values of single tables, of which one bounds the other
static void check_pairs(Deck &deck) {
   const Value *inner = deck.value("geometry", "inner_radius"),
               *outer = deck.value("geometry", "outer_radius");
   if (inner && outer && outer->number() <= inner->number())
      deck.refuse(*deck.single("geometry"), "outer_radius",
                  "must be greater than inner_radius = " + inner->plain() + ", not " +
                      outer->plain());
   const Value *step = deck.value("dynamics", "time_step"), *end = deck.value("dynamics", "end_time");
   const double steps = step && end ? end->number() / step->number() : 1.0;
   if (std::round(steps) < 1.0 || std::abs(steps - std::round(steps)) > 1e-6 * steps)
      deck.refuse(*deck.single("dynamics"), "end_time",
                  "must be a whole number of time steps of " + step->plain() + ", not " + end->plain());
}

// A probe needs the data with which an exact solution or a reference is compared
static void check_compared(Deck &deck) {
   std::multimap<std::string, const Section *> probes;
   for (const Section *probe : deck.entries("probe"))
      probes.emplace(probe->text("name"), probe);
   for (const char *table : {"exact", "reference"}) {
      for (Section *section : deck.entries(table)) {
         const bool exact = section->spec->name == "exact";
         const Value *name = section->find("probe");
         if (!name)
            continue;
         const auto [first, last] = probes.equal_range(name->text);
         for (auto probe = first; probe != last; ++probe) {
            const std::string quantity = probe->second->text("quantity");
            const bool vector =
                quantity == "u" || quantity == "force" || quantity == "section_force";
            const bool local = quantity[0] != 'u' && quantity.find("force") == std::string::npos &&
                               quantity.compare(0, 6, "torque") != 0 && !of_whole_body(quantity);
            if (quantity.empty() || (exact ? local : !vector))
               continue;
            deck.refuse(*section, "probe",
                        quoted(name->text) + " is of " + quantity + ", " +
                            (exact ? "which a homogeneous solution does not give"
                                   : "three numbers; choose a component"));
         }
      }
   }
}

void check_rules(Deck &deck) {
   check_materials(deck);
   check_boundary(deck);
   check_amplitudes(deck);
   check_probes(deck);
   check_compared(deck);
   check_pairs(deck);
}

} // namespace rk
