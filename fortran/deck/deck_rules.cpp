// What depends on more than the schema can say, and the values derived from others.
#include "deck.h"

#include <algorithm>
#include <cmath>

namespace rk {

static Value numbers(const std::vector<double> &list, const Origin &origin) {
   Value array;
   array.kind = Value::Kind::array;
   array.origin = origin;
   for (double x : list) {
      Value item;
      item.kind = Value::Kind::real;
      item.real = x;
      item.origin = origin;
      array.items.push_back(item);
   }
   return array;
}

static double number_of(const Section *section, const std::string &key, double otherwise) {
   const Value *value = section ? section->find(key) : nullptr;
   return value ? value->number() : otherwise;
}

// Names of the faces; empty for a model file, whose sets are not known here
static std::vector<std::string> sets_of(const std::string &kind, int dimension) {
   if (kind == "annulus")
      return {"inner", "outer", "x0", "y0"};
   if (kind == "box" && dimension == 1)
      return {"x0", "x1"};
   if (kind == "box" && dimension == 2)
      return {"x0", "x1", "y0", "y1"};
   if (kind == "box")
      return {"x0", "x1", "y0", "y1", "z0", "z1"};
   return {};
}

static void check_materials(Deck &deck, const std::string &kind, int dimension) {
   const std::vector<Section *> materials = deck.entries("material");
   const Section *scene = deck.single("scene");
   const std::string method = scene ? scene->text("method") : "";
   for (Section *material : materials) {
      const Value *bulk = material->find("K");
      if (bulk && !std::isfinite(bulk->number()) && !method.empty() && method != "auto" &&
          method != "rkcm-mixed")
         deck.complain(bulk->origin, deck.address(*material, "K"),
                       "inf is only for scene.method = rkcm-mixed, where the pressure is an "
                       "unknown; here scene.method = " +
                           method);
      if (materials.size() > 1 && !material->find("label") && !material->refused.count("label"))
         deck.complain(material->origin, deck.address(*material, "label"),
                       "missing, an integer is needed where there are several materials");
      if (const Value *angle = material->find("fiber_angle"); angle && !material->find("fiber")) {
         const double radians = angle->number() * std::acos(-1.0) / 180.0;
         const double across = std::sin(radians), along = std::cos(radians);
         material->values["fiber"] = dimension == 2 ? numbers({across, along, 0.0}, angle->origin)
                                                    : numbers({across, 0.0, along}, angle->origin);
      }
      if (material->text("model") == "muscle" && (kind == "box" || kind == "annulus") &&
          !material->find("fiber") && !material->refused.count("fiber") &&
          !material->refused.count("fiber_angle"))
         deck.complain(material->origin, deck.address(*material, "fiber"),
                       "missing, a muscle in geometry.kind = " + kind +
                           " needs fiber or fiber_angle");
   }
}

static void check_sets(Deck &deck, const std::string &kind, int dimension) {
   const std::vector<std::string> sets = sets_of(kind, dimension);
   if (sets.empty())
      return;
   for (const char *table : {"boundary", "probe"}) {
      for (Section *section : deck.entries(table)) {
         const Value *set = section->find("set");
         if (!set || std::find(sets.begin(), sets.end(), set->text) != sets.end())
            continue;
         deck.complain(set->origin, deck.address(*section, "set"),
                       quoted(set->text) + " is no side of this " + kind + "; there are " +
                           join(sets, ", "));
      }
   }
   for (Section *section : deck.entries("boundary")) {
      const Value *radial = section->find("radial");
      if (!radial || kind != "annulus")
         continue;
      const std::string set = section->text("set");
      if (set == "x0" || set == "y0")
         deck.complain(radial->origin, deck.address(*section, "radial"),
                       "only on the sets inner and outer");
      else if (section->find("u_x") || section->find("u_y"))
         deck.complain(radial->origin, deck.address(*section, "radial"),
                       "cannot be given beside u_x or u_y");
   }
}

static void check_points(Deck &deck, const Section &geometry, int dimension) {
   const Value *size = geometry.find("size");
   const double inner = number_of(&geometry, "inner_radius", 0.0),
                outer = number_of(&geometry, "outer_radius", 0.0);
   // Points on the surface may be off it by rounding
   const double slack = 1e-9;
   for (Section *probe : deck.entries("probe")) {
      const std::string quantity = probe->text("quantity");
      if (dimension == 2 && (quantity == "u_z" || quantity == "force_z"))
         deck.complain(probe->find("quantity")->origin, deck.address(*probe, "quantity"),
                       quantity + " is always zero in two dimensions");
      const Value *point = probe->find("point");
      if (!point)
         continue;
      bool inside = true;
      for (std::size_t i = 0; size && i < std::min(size->items.size(), point->items.size()); ++i) {
         const double edge = size->items[i].number(), x = point->items[i].number();
         inside = inside && x >= -slack * edge && x <= (1.0 + slack) * edge;
      }
      if (geometry.text("kind") == "annulus" && point->items.size() == 2 && outer > inner) {
         const double x = point->items[0].number(), y = point->items[1].number(),
                      r = std::hypot(x, y);
         inside = x >= -slack * outer && y >= -slack * outer && r >= inner - slack * outer &&
                  r <= outer + slack * outer;
      }
      if (!inside)
         deck.complain(point->origin, deck.address(*probe, "point"),
                       point->plain() + " lies outside the " + geometry.text("kind"));
   }
}

static void check_geometry(Deck &deck, const Section &geometry, int dimension) {
   const Value *inner = geometry.find("inner_radius"), *outer = geometry.find("outer_radius");
   if (inner && outer && outer->number() <= inner->number())
      deck.complain(outer->origin, deck.address(geometry, "outer_radius"),
                    "must be greater than inner_radius = " + inner->plain() + ", not " +
                        outer->plain());
   const Value *kind = geometry.find("kind");
   if (kind && kind->text != "box" && dimension != 0 &&
       dimension != (kind->text == "annulus" ? 2 : 3))
      deck.complain(kind->origin, deck.address(geometry, "kind"),
                    kind->text +
                        " needs scene.dimension = " + (kind->text == "annulus" ? "2" : "3") +
                        ", not " + std::to_string(dimension));
}

// A probe must have what an exact solution or a reference is compared with
static void check_compared(Deck &deck) {
   for (const char *table : {"exact", "reference"}) {
      for (Section *section : deck.entries(table)) {
         const bool exact = section->spec->name == "exact";
         const Value *name = section->find("probe");
         if (!name)
            continue;
         for (Section *probe : deck.entries("probe")) {
            const std::string quantity = probe->text("quantity");
            const bool vector = quantity == "u" || quantity == "force";
            const bool local = quantity[0] != 'u' && quantity.compare(0, 5, "force") != 0;
            if (probe->text("name") != name->text || quantity.empty() || (exact ? local : !vector))
               continue;
            deck.complain(name->origin, deck.address(*section, "probe"),
                          quoted(name->text) + " is of " + quantity + ", " +
                              (exact ? "which a homogeneous solution does not give"
                                     : "three numbers; choose a component"));
         }
      }
   }
}

static void check_references(Deck &deck) {
   const double full = number_of(deck.single("load"), "activation", 0.0);
   for (Section *reference : deck.entries("reference")) {
      const Value *activation = reference->find("activation"), *value = reference->find("value");
      const Value *load = activation ? activation : reference->find("load");
      if (load && value && load->items.size() != value->items.size())
         deck.complain(value->origin, deck.address(*reference, "value"),
                       "must have as many items as " +
                           std::string(activation ? "activation" : "load") + ", " +
                           std::to_string(load->items.size()) + ", not " +
                           std::to_string(value->items.size()));
      if (!activation)
         continue;
      std::vector<double> fractions;
      // without activation the run meets none of them
      for (const Value &item : activation->items) {
         if (full > 0.0)
            fractions.push_back(item.number() / full);
      }
      reference->values["load"] = numbers(fractions, activation->origin);
   }
}

// A linear problem stands alone, and its solution must fit it
static void check_linear(Deck &deck, const std::string &kind, int dimension) {
   const Section *linear = deck.single("linear"), *scene = deck.single("scene");
   if (!linear) {
      for (Section *pin : deck.entries("pin"))
         deck.complain(pin->origin, deck.address(*pin), "only for linear problems");
      if (dimension == 1)
         deck.complain(scene->find("dimension")->origin, "scene.dimension",
                       "1 is only for linear problems: the table [linear] is missing");
      return;
   }
   for (const char *table : {"material", "boundary", "exact", "reference"}) {
      for (Section *section : deck.entries(table))
         deck.complain(section->origin, deck.address(*section),
                       "has no place in a linear problem, where [linear] says it all");
   }
   if (!kind.empty() && kind != "box")
      deck.complain(deck.single("geometry")->find("kind")->origin, "geometry.kind",
                    "must be box for a linear problem, not " + kind);
   const Value *method = scene ? scene->find("method") : nullptr;
   if (method && method->text != "rkcm" && method->text != "auto")
      deck.complain(method->origin, "scene.method",
                    "must be rkcm for a linear problem, not " + method->text);
   const std::string problem = linear->text("problem"), solution = linear->text("solution");
   const Value *name = linear->find("solution");
   if ((solution == "exp_x" && dimension != 1) || (solution == "exp_xy" && dimension != 2) ||
       (solution == "cantilever" && dimension != 2))
      deck.complain(name->origin, "linear.solution",
                    solution + " needs scene.dimension = " + (solution == "exp_x" ? "1" : "2") +
                        ", not " + std::to_string(dimension));
   if (solution == "exp_x" || solution == "exp_xy" || solution == "cantilever") {
      const std::string fits = solution == "cantilever" ? "elasticity" : "poisson";
      if (!problem.empty() && problem != fits)
         deck.complain(name->origin, "linear.solution",
                       solution + " is a solution of problem = " + fits + ", not " + problem);
   }
   const std::vector<std::string> sets = sets_of(kind, dimension);
   const Value *essential = linear->find("essential");
   for (std::size_t i = 0; essential && !sets.empty() && i < essential->items.size(); ++i) {
      const std::string &set = essential->items[i].text;
      if (std::find(sets.begin(), sets.end(), set) == sets.end())
         deck.complain(essential->origin, "linear.essential",
                       quoted(set) + " is no side of this " + kind + "; there are " +
                           join(sets, ", "));
   }
   for (Section *probe : deck.entries("probe")) {
      const std::string quantity = probe->text("quantity");
      // forces come from virtual work, which does not know the sources of the other solutions
      const bool force = quantity.compare(0, 5, "force") == 0;
      const bool fits = problem == "poisson" ? quantity == "u"
                        : force              ? solution == "cantilever"
                                             : quantity != "J";
      if (!quantity.empty() && !fits)
         deck.complain(probe->find("quantity")->origin, deck.address(*probe, "quantity"),
                       quantity + " is not known in a linear problem of " + problem + " with " +
                           solution);
   }
}

void check_rules(Deck &deck) {
   const int dimension = static_cast<int>(number_of(deck.single("scene"), "dimension", 0.0));
   const Section *geometry = deck.single("geometry");
   const std::string kind = geometry ? geometry->text("kind") : "";
   check_materials(deck, kind, dimension);
   check_sets(deck, kind, dimension);
   check_compared(deck);
   check_references(deck);
   check_linear(deck, kind, dimension);
   if (!geometry)
      return;
   check_geometry(deck, *geometry, dimension);
   check_points(deck, *geometry, dimension);
}

} // namespace rk
