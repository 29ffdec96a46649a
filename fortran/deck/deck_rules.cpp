// What depends on more than the schema can say and can be checked without points. What follows from
// the values, and all that needs points, is Fortran's (solve/).
#include "deck.h"
#include "expression.h"

#include <algorithm>
#include <cmath>
#include <set>

namespace rk {

static void check_materials(Deck &deck) {
   const std::vector<Section *> materials = deck.entries("material");
   const std::string method = deck.word("scene", "method");
   const bool regions = std::any_of(materials.begin(), materials.end(), [](Section *material) {
      return material->given("where");
   });
   for (Section *material : materials) {
      const Value *label = material->find("label");
      const bool where = material->given("where");
      if (regions && label)
         deck.refuse(*material, "label",
                     "cannot be given where materials are placed by `where`: only a model has labels");
      if (regions && material != materials.front() && !where)
         deck.refuse(*material, "where",
                     "missing: only the first material may omit it and fill the rest");
      const Value *bulk = material->find("K");
      if (bulk && !std::isfinite(bulk->number()) && method == "rkcm")
         deck.refuse(*material, "K",
                     "inf needs the pressure as an unknown: use scene.method = rkpm-gauss, "
                     "rkpm-scni or rkcm-mixed instead of rkcm");
      const Value *activation = material->find("activation");
      if (activation && activation->kind == Value::Kind::text && method.compare(0, 4, "rkpm") != 0)
         deck.refuse(*material, "activation",
                     "an expression is only for scene.method = rkpm-gauss or rkpm-scni");
      if (!regions && materials.size() > 1 && !material->given("label"))
         deck.refuse(*material, "label", "missing, an integer is needed where there are several materials");
   }
}

// Collocation sees second derivatives, which functions of order 1 do not approach: by (5.19) the
// error is of order h^(p-1)
static void check_order(Deck &deck) {
   const std::string method = deck.word("scene", "method");
   const Value *order = deck.value("approximation", "order");
   if (order && order->number() < 2.0 && (method == "rkcm" || method == "rkcm-mixed"))
      deck.refuse(*deck.single("approximation"), "order",
                  "must be at least 2 for scene.method = " + method +
                      ": second derivatives of functions of order 1 do not converge; use "
                      "order = 2 and support = 3, or scene.method = rkpm-gauss");
}

// The plate at the end of a tendon moves as nothing else says
static void check_tendon(Deck &deck, Section &section) {
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

bool of_whole_body(const std::string &quantity) {
   return quantity == "energy" || quantity == "fiber_stretch" || quantity == "pennation";
}

static void check_probes(Deck &deck, int dimension) {
   const bool weak = deck.word("scene", "method").compare(0, 4, "rkpm") == 0;
   for (Section *probe : deck.entries("probe")) {
      const std::string quantity = probe->text("quantity");
      const Value *material = probe->find("material");
      const bool whole = of_whole_body(quantity);
      const auto given = [&](const char *key) {
         return probe->given(key);
      };
      const bool of_set =
          quantity.compare(0, 5, "force") == 0 || quantity.compare(0, 6, "torque") == 0;
      if (!whole && !of_set && quantity != "expression" && !given("point") && !given("set"))
         deck.refuse(*probe, "", "needs one of the keys point, set");
      for (const char *key : {"point", "set"}) {
         if (whole && probe->find(key))
            deck.refuse(*probe, key, "cannot be given for " + quantity + ", a quantity of the whole body");
      }
      if (material && !whole && !weak)
         deck.refuse(*probe, "material",
                     "the force of one material needs a Galerkin form, such as scene.method = rkpm-gauss");
      if (dimension == 2 && (quantity == "u_z" || quantity == "force_z" || quantity == "torque_x" ||
                             quantity == "torque_y" || quantity == "section_force_z"))
         deck.refuse(*probe, "quantity", quantity + " is always zero in two dimensions");
   }
}

static void check_geometry(Deck &deck, const Section &geometry, int dimension) {
   const Value *inner = geometry.find("inner_radius"), *outer = geometry.find("outer_radius");
   if (inner && outer && outer->number() <= inner->number())
      deck.refuse(geometry, "outer_radius",
                  "must be greater than inner_radius = " + inner->plain() + ", not " +
                      outer->plain());
   const Value *kind = geometry.find("kind");
   if (kind && kind->text != "box" && dimension != 0 &&
       dimension != (kind->text == "annulus" ? 2 : 3))
      deck.refuse(geometry, "kind",
                  kind->text +
                      " needs scene.dimension = " + (kind->text == "annulus" ? "2" : "3") +
                      ", not " + std::to_string(dimension));
   if (kind && kind->text == "model" && deck.word("scene", "method") == "rkcm-mixed")
      deck.refuse(geometry, "kind",
                  "model has no lattice, whose cells the volume rows of rkcm-mixed need: use "
                  "scene.method = rkpm-gauss, rkpm-scni or rkcm");
}

// A probe must have what an exact solution or a reference is compared with
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
   const int dimension = deck.dimension();
   const Section *geometry = deck.single("geometry");
   check_materials(deck);
   check_order(deck);
   check_boundary(deck);
   check_amplitudes(deck);
   check_probes(deck, dimension);
   check_compared(deck);
   check_linear(deck);
   if (geometry)
      check_geometry(deck, *geometry, dimension);
}

} // namespace rk
